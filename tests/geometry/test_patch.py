import math

import numpy as np
import pytest
import torch
import trimesh

from pinwm_drake.geometry.patch import PROTRUSION, resting_points
from pinwm_drake.spatial.rotations import quaternion_exp, quaternion_to_matrix

UPRIGHT = np.eye(3)


def on_floor(points, R_WO=UPRIGHT):
    heights = points @ R_WO[2]
    return points[heights < heights.min() + 0.5 * PROTRUSION]


def mean_distance(points):
    return np.linalg.norm((points - points.mean(0))[:, :2], axis=1).mean()


def test_square_turns_against_the_torque_of_uniform_pressure():
    # The mean distance from a square's middle: side (sqrt 2 + asinh 1) / 6.
    points = on_floor(resting_points(trimesh.creation.box((0.06, 0.06, 0.06)), UPRIGHT))
    closed_form = 0.06 * (math.sqrt(2) + math.asinh(1)) / 6
    # 4,000 samples of a mean whose relative deviation is 0.37: 0.6 %, three times.
    assert mean_distance(points) == pytest.approx(closed_form, rel=0.018)


def test_disc_turns_against_the_torque_of_uniform_pressure():
    points = on_floor(resting_points(trimesh.creation.cylinder(0.04, 0.08, sections=96), UPRIGHT))
    assert mean_distance(points) == pytest.approx(2 / 3 * 0.04, rel=0.018)


def test_points_lie_in_the_face_and_stand_out_of_it():
    box = trimesh.creation.box((0.1, 0.06, 0.04))
    points = resting_points(box, UPRIGHT)
    low = on_floor(points)
    assert np.allclose(low[:, 2], -0.02 - PROTRUSION, atol=1e-12)
    assert (np.abs(low[:, :2]) < [0.05, 0.03]).all()
    # The corners are there too: on them it tips.
    for corner in box.vertices:
        assert np.linalg.norm(points - corner, axis=1).min() < 1e-9


def test_middle_of_the_points_is_that_of_the_face():
    bar, stem = trimesh.creation.box((0.1, 0.04, 0.05)), trimesh.creation.box((0.04, 0.1, 0.05))
    bar.apply_translation((0, -0.05, 0))
    stem.apply_translation((0, 0.02, 0))
    low = on_floor(resting_points(trimesh.util.concatenate([bar, stem]), UPRIGHT))
    assert np.linalg.norm(low.mean(0)[:2] - [0, -0.015]) < 1.2e-3  # that of 4,000 samples


def test_a_turned_object_rests_on_the_face_that_is_down():
    R_WO = quaternion_to_matrix(quaternion_exp(torch.tensor([math.pi / 2, 0.0, 0.0]).double())).numpy()
    low = on_floor(resting_points(trimesh.creation.box((0.1, 0.06, 0.04)), R_WO), R_WO)
    # y of the box is up: it rests on the face at -y, of 100 mm by 40 mm.
    assert np.allclose(low[:, 1], -0.03 - PROTRUSION)


def test_same_seed_same_points():
    box = trimesh.creation.box((0.1, 0.06, 0.04))
    assert np.array_equal(resting_points(box, UPRIGHT, seed=3), resting_points(box, UPRIGHT, seed=3))


def test_a_ball_and_an_edge_have_no_face():
    tilted = quaternion_to_matrix(quaternion_exp(torch.tensor([math.pi / 4, 0.0, 0.0]).double())).numpy()
    assert resting_points(trimesh.creation.icosphere(4, 0.03), UPRIGHT) is None
    assert resting_points(trimesh.creation.box((0.1, 0.06, 0.04)), tilted) is None
