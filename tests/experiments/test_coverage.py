# SPDX-License-Identifier: MIT
import numpy as np
import pytest
import trimesh

from pinwm_drake.experiments.evaluation.coverage import coverage


def pose(x, y, yaw):
    X = trimesh.transformations.rotation_matrix(yaw, [0.0, 0.0, 1.0])
    X[:2, 3] = x, y
    return X


def t_block():
    bar = trimesh.creation.box((0.2, 0.05, 0.03))
    bar.apply_translation([0.0, 0.1, 0.0])
    stem = trimesh.creation.box((0.05, 0.15, 0.03))
    return trimesh.util.concatenate([bar, stem])


@pytest.mark.parametrize(("x", "y"), [(0.0, 0.0), (0.013, 0.0), (0.02, -0.01), (0.3, 0.0)])
def test_a_box_covers_what_its_sides_say(x, y):
    box = trimesh.creation.box((0.1, 0.06, 0.03))
    wanted = max(0.1 - abs(x), 0.0) * max(0.06 - abs(y), 0.0) / (0.1 * 0.06)
    assert coverage(box, pose(x + 0.2, y, 0.0), pose(0.2, 0.0, 0.0)) == pytest.approx(wanted, abs=5e-3)


def test_a_t_that_is_turned_covers_what_its_parts_share():
    # Turned by half a turn about the middle of its bar, the bar covers itself, and the stem nothing.
    half = pose(0.0, 0.2, np.pi)
    area = 0.2 * 0.05 + 0.05 * 0.15
    shared = 0.2 * 0.05
    assert coverage(t_block(), half, pose(0.0, 0.0, 0.0)) == pytest.approx(shared / area, abs=0.01)
    assert coverage(t_block(), pose(0.1, 0.2, 0.7), pose(0.1, 0.2, 0.7)) == 1.0
