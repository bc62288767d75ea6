# SPDX-License-Identifier: MIT
"""The time step of a twin follows from how far the pusher moves in it."""

from types import SimpleNamespace

import numpy as np
import pytest

from pinwm_drake.identification.time_step import LONGEST, MOST_WAY, time_step_of, way_in_a_step


def push(speed, rate=30.0):
    """Push that stands, moves at a speed [m/s] and stands again, logged at a rate [Hz]."""
    t = np.arange(0.0, 1.0, 1.0 / rate)
    x = speed * np.clip(t - 0.3, 0.0, 0.4)
    return SimpleNamespace(times=t, trajectory=SimpleNamespace(t=t, p_WP=np.stack([0.6 * x, -0.8 * x, 0 * x], -1)))


@pytest.mark.parametrize(
    ("speeds", "halvings"), [((0.0,), 0), ((0.1, 0.3), 0), ((1.2,), 0), ((1.3, 0.1), 1), ((2.4,), 1), ((3.0,), 2)]
)
def test_the_pusher_moves_by_five_millimetres_at_most(speeds, halvings):
    # At v m/s it moves by v / 240 in 1/240 s: 5 mm are 1.2 m/s.
    pushes = [push(speed) for speed in speeds]
    step = time_step_of(pushes)
    assert step == LONGEST / 2**halvings
    assert way_in_a_step(pushes, step) == pytest.approx(max(speeds) * step)
    assert way_in_a_step(pushes, step) <= MOST_WAY * (1.0 + 1e-9)


def test_what_the_pusher_does_while_nothing_is_seen_does_not_count():
    fast = push(3.0)
    fast.times = fast.times[fast.times > 0.75]
    assert time_step_of([fast]) == LONGEST
