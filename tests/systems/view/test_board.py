# SPDX-License-Identifier: MIT
import math

import numpy as np
import pytest

from pinwm_drake.systems.view.board import Board
from pinwm_drake.systems.view.meshcat import make_meshcat
from tests.systems.shown import matrix, value


@pytest.fixture(scope="module")
def meshcat():
    return make_meshcat()


def test_a_board_stands_before_the_camera_where_it_is_told(meshcat):
    board = Board(meshcat, "words", -0.4, 0.3, 0.001)
    board.show(np.zeros((100, 300, 4), np.uint8), 0.0)
    x, y, z = matrix(meshcat, f"{board.path}/0")[:3, 3]
    # The camera looks along -z, and sees 75 degrees: at that depth a page's height is this.
    page = -2 * z * math.tan(math.radians(37.5))
    assert 0.01 < -z < 0.1
    # Its middle: half of 0.3 page heights to the right of its left edge, and half of 0.1 below its upper one.
    assert (x, y) == pytest.approx(((-0.4 + 0.15) * page, (0.3 - 0.05) * page))
    other = Board(meshcat, "paper", -0.4, 0.3, 0.001, behind=True)
    other.show(np.zeros((100, 300, 4), np.uint8), 0.0)
    farther = matrix(meshcat, f"{other.path}/0")[:3, 3]
    assert farther[2] < z
    np.testing.assert_allclose(farther / farther[2], np.array([x, y, z]) / z)


def test_pictures_replace_each_other_unless_they_are_kept(meshcat):
    board = Board(meshcat, "picture", 0, 0, 0.01)
    for shade in (0, 100, 200):
        board.show(np.full((8, 8, 3), shade, np.uint8), 0.1 * shade)
    assert meshcat.HasPath(f"{board.path}/0")
    assert not meshcat.HasPath(f"{board.path}/1")
    kept = Board(meshcat, "picture", 0, 0, 0.01, kept=2)
    for shade in (0, 60, 120, 180):
        kept.show(np.full((8, 8, 3), shade, np.uint8), 0.1 * shade)
    # The last place is for all that come later.
    assert [meshcat.HasPath(f"{kept.path}/{k}") for k in range(4)] == [True, True, True, False]
    assert [value(meshcat, f"{kept.path}/{k}", "visible") for k in range(3)] == [False, False, True]
