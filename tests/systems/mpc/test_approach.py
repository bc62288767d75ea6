# SPDX-License-Identifier: MIT
import itertools
import math

import numpy as np
import pytest

from pinwm_drake.systems.mpc.approach import way_past

MIDDLE, CLEAR = np.array([0.3, -0.1, 0.05]), (0.08, 0.12)


def fine(points):
    return np.concatenate([np.linspace(a, b, 50) for a, b in itertools.pairwise(points)])


@pytest.mark.parametrize("longest", [0.1, 0.005])
@pytest.mark.parametrize("height", [0.03, 0.2])
@pytest.mark.parametrize("turn", [0.0, 0.4, 2.0, math.pi, -3.0])
def test_a_way_past_an_object_does_not_touch_it(turn, height, longest):
    begin = np.array([0.4, -0.1, height])
    end = MIDDLE + np.array([0.09 * math.cos(turn), 0.09 * math.sin(turn), -0.01])
    points = way_past(MIDDLE, begin, end, CLEAR, longest)
    np.testing.assert_allclose(points[[0, -1]], [begin, end], atol=1e-12)
    assert np.linalg.norm(np.diff(points, axis=0), axis=1).max() <= longest + 1e-12
    level = np.linalg.norm(fine(points)[:, :2] - MIDDLE[:2], axis=1)
    assert np.all((level > CLEAR[0] - 1e-12) | (fine(points)[:, 2] > CLEAR[1] - 1e-12))


def test_a_way_that_is_clear_is_straight_and_others_go_over_the_object():
    begin, beside, opposite = np.array([[0.4, -0.1, 0.05], [0.4, 0.1, 0.04], [0.2, -0.1, 0.04]])
    assert np.ptp(np.cross(way_past(MIDDLE, begin, beside, CLEAR, 0.01) - begin, beside - begin)) < 1e-12
    over = way_past(MIDDLE, begin, opposite, CLEAR, 0.01)
    assert over[:, 2].max() == CLEAR[1]
    assert np.ptp(over[:, 1]) < 1e-12
    assert len(over) - 1 == 7 + 20 + 8


def test_a_pusher_over_the_object_stays_at_its_height_until_it_is_above_the_end():
    begin, end = MIDDLE + np.array([[0.02, 0.01, 0.11], [-0.1, 0.03, -0.01]])
    points = way_past(MIDDLE, begin, end, CLEAR, 0.03)
    off = np.hypot(*(points[:, :2] - end[:2]).T)
    assert np.all((points[:, 2] == begin[2]) | (off < 1e-12))
