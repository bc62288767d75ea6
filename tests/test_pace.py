# SPDX-License-Identifier: MIT
import math
import time

import pytest

from pinwm_drake.pace import Pace


@pytest.fixture
def clock(monkeypatch):
    """Time that passes as the test says."""
    now = [100.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    return now


def test_the_first_unit_does_not_count(clock):
    pace = Pace()
    assert pace.begun == 100.0
    assert all(map(math.isnan, pace(0.0, 0)))
    clock[0] += 300.0  # most of it compiles kernels
    assert all(map(math.isnan, pace(0.1, 50)))
    clock[0] += 10.0
    assert pace(0.2, 100) == pytest.approx((5.0, 80.0))
    clock[0] += 30.0
    assert pace(0.4, 200) == pytest.approx((3.75, 80.0))


def test_reports_without_work_end_no_unit(clock):
    pace = Pace()
    for _ in range(3):
        assert all(map(math.isnan, pace(0.5)))
        clock[0] += 60.0
    assert all(map(math.isnan, pace(0.6)))
    clock[0] += 5.0
    assert pace(0.8)[1] == pytest.approx(5.0)


def test_nothing_is_left_of_what_is_done(clock):
    pace = Pace()
    pace(0.0)
    clock[0] += 5.0
    assert pace(1.0)[1] == 0.0
