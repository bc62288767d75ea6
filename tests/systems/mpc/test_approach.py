# SPDX-License-Identifier: MIT
import itertools
import math

import numpy as np
import pytest

from pinwm_drake.systems.mpc.approach import around, over


@pytest.mark.parametrize("turn", [0.0, 0.4, 2.0, math.pi, -3.0])
def test_a_way_around_an_axis_keeps_clear_of_it(turn):
    middle, begin = np.array([0.3, -0.1, 0.05]), np.array([0.4, -0.1, 0.25])
    end = middle + np.array([0.09 * math.cos(turn), 0.09 * math.sin(turn), 0.01])
    points = around(middle, begin, end, 0.1)
    np.testing.assert_allclose(points[[0, -1]], [begin, end], atol=1e-12)
    assert np.linalg.norm(np.diff(points, axis=0), axis=1).max() <= 0.1 + 1e-12
    fine = np.concatenate([np.linspace(a, b, 50) for a, b in itertools.pairwise(points)])
    assert np.linalg.norm(fine[:, :2] - middle[:2], axis=1).min() > 0.09 - 1e-3
    assert len(points) < 10
    slow = around(middle, begin, end, 0.005)
    assert np.linalg.norm(np.diff(slow, axis=0), axis=1).max() <= 0.005 + 1e-12


@pytest.mark.parametrize("longest", [0.1, 0.03])
def test_a_way_over_an_object_is_level_until_it_is_above_its_end(longest):
    begin, end = np.array([0.02, 0.01, 0.16]), np.array([-0.1, 0.03, 0.04])
    points = over(begin, end, longest)
    np.testing.assert_allclose(points[[0, -1]], [begin, end], atol=1e-12)
    assert np.linalg.norm(np.diff(points, axis=0), axis=1).max() <= longest + 1e-12
    off = np.hypot(*(points[:, :2] - end[:2]).T)
    assert np.all((points[:, 2] == begin[2]) | (off < 1e-12))
    assert len(points) - 1 == math.ceil(np.hypot(0.12, 0.02) / longest) + math.ceil(0.12 / longest)
