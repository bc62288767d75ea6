# SPDX-License-Identifier: MIT
import math

import numpy as np
import pytest
import torch
import trimesh
from scipy.spatial.transform import Rotation

from pinwm_drake.errors import GeometryError
from pinwm_drake.geometry.meshes import load_mesh
from pinwm_drake.geometry.patch import corner_spread, resting_points, supporting_points
from pinwm_drake.geometry.pieces import ANYHOW, IF_FLAT, MAX_FLOOR_POINTS, PROTRUSION, UNLESS_FLAT
from pinwm_drake.geometry.shapes import box, convex_hull
from pinwm_drake.geometry.stored_pieces import mesh_pieces
from pinwm_drake.models import object_model
from pinwm_drake.physics.model import Body, Model
from pinwm_drake.physics.parameters import Parameters
from pinwm_drake.physics.state import State
from pinwm_drake.physics.stepper import Stepper
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


def test_every_face_of_a_cube_has_points_and_no_corner_is_lost():
    mesh = trimesh.creation.box((0.06, 0.06, 0.06))
    points = supporting_points(mesh, UPRIGHT)
    assert np.array_equal(on_floor(points[:12, :3]), points[:12, :3])
    for normal in np.concatenate([np.eye(3), -np.eye(3)]):
        own = points[(points[:, 3] == IF_FLAT) & (points[:, 4:] @ normal > 0.99)]
        assert len(own) == 12
        assert np.allclose(own[:, :3] @ normal, 0.03 + PROTRUSION)
    assert (points[points[:, 3] == ANYHOW][:, 4:] == 0.0).all()
    assert len(points) == 6 * 12 + 8


def test_outline_of_a_round_face_counts_once_it_tips():
    points = supporting_points(trimesh.creation.cylinder(0.04, 0.08, sections=48), UPRIGHT)
    outline = points[points[:, 3] == UNLESS_FLAT]
    assert len(outline) == 2 * (48 - 4)
    assert np.allclose(np.abs(outline[:, 6]), 1.0)


@pytest.mark.parametrize("face", [(0.0, 0.0, 0.0), (math.pi / 2, 0.0, 0.0), (0.0, -math.pi / 2, 0.0)])
def test_spinning_cube_comes_to_rest_alike_on_every_face(face):
    # The torque of uniform pressure, mu m g times 0.3826 sides, stops I w in I w / torque seconds.
    side, mu, w = 0.06, 0.3, 10.0
    points = supporting_points(trimesh.creation.box((side,) * 3), UPRIGHT)
    inertia = 0.5 / 6.0 * side**2
    body = Body("cube", [box((side,) * 3)], 0.5, inertia * np.eye(3), floor_points=points)
    model = Model(bodies=[body], time_step=1.0 / 960.0)
    q = quaternion_exp(torch.tensor(face, dtype=torch.float64))
    state = State.at_rest(
        model,
        q_WB=q.expand(1, 1, 4),
        p_WB=(0.0, 0.0, 0.5 * side + PROTRUSION),
        V_WB=torch.tensor([[[0.0, 0.0, w, 0.0, 0.0, 0.0]]], dtype=torch.float64),
    )
    theta = Parameters.nominal(model, friction_floor=mu)
    rolled = Stepper(model).rollout(theta, state, torch.zeros(40, 1, 6, dtype=torch.float64))
    lost = w - float(rolled.V_WB[-1, 0, 0, 2])
    torque = mu * 0.5 * 9.81 * side * (math.sqrt(2) + math.asinh(1)) / 6
    assert lost == pytest.approx(torque / inertia * 40 / 960, rel=0.02)


def test_lying_cylinder_rolls_on_all_of_its_corners():
    # A prism of 48 sides rolls over its edges; on four corners at each end it would stop.
    mesh = trimesh.creation.cylinder(0.04, 0.08, sections=48)
    points = supporting_points(mesh, UPRIGHT)
    inertia = np.diag([0.5 / 12 * (3 * 0.04**2 + 0.08**2)] * 2 + [0.5 * 0.5 * 0.04**2])
    body = Body("prism", [convex_hull(mesh.vertices)], 0.5, inertia, floor_points=points)
    model = Model(bodies=[body], time_step=1.0 / 960.0)
    q = quaternion_exp(torch.tensor([math.pi / 2, 0.0, 0.0], dtype=torch.float64))
    state = State.at_rest(
        model,
        q_WB=q.expand(1, 1, 4),
        p_WB=(0.0, 0.0, 0.0401),
        V_WB=torch.tensor([[[0.0, 5.0, 0.0, 0.2, 0.0, 0.0]]], dtype=torch.float64),
    )
    theta = Parameters.nominal(model, friction_floor=0.5)
    rolled = Stepper(model).rollout(theta, state, torch.zeros(240, 1, 6, dtype=torch.float64))
    assert float(rolled.p_WB[-1, 0, 0, 0]) > 0.03
    assert float(rolled.p_WB[:, 0, 0, 2].min()) > 0.0395


def test_a_floor_point_that_counts_at_no_known_time_is_refused():
    points = supporting_points(trimesh.creation.box((0.06, 0.06, 0.06)), UPRIGHT)
    points[3, 3] = 5.0
    body = Body("cube", [box((0.06,) * 3)], 0.5, 3e-4 * np.eye(3), floor_points=points)
    with pytest.raises(GeometryError, match="floor point 3 counts when 5"):
        Model(bodies=[body]).arrays  # noqa: B018


def test_more_points_than_are_kept_of_corners_leave_the_patch_whole():
    # The T-block's corners and the points of its face are more than are kept of corners alone. Its spin is to meet the
    # torque of uniform pressure on the T all the same.
    model = object_model("t_block")
    mesh = load_mesh(model.mesh_path)
    # The yaw decides which corners are the outermost.
    q_WO = quaternion_exp(torch.tensor([0.0, 0.0, -2.5], dtype=torch.float64))
    points = supporting_points(mesh, quaternion_to_matrix(q_WO).numpy())
    low = points[:, 2] < mesh.vertices[:, 2].min() + 1e-6
    own = (points[:, 3] != IF_FLAT) | (points[:, 6] < -0.5)
    assert (low & own).sum() > MAX_FLOOR_POINTS
    below = np.flatnonzero(mesh.face_normals[:, 2] < -0.999)
    bottom = trimesh.Trimesh(mesh.vertices, mesh.faces[below], process=False)
    samples = np.asarray(trimesh.sample.sample_surface(bottom, 40000, seed=0)[0])[:, :2]
    moment, mu, w = 1e-3, 0.3, 10.0
    body = Body("t", mesh_pieces(model.mesh_path), 0.5, moment * np.eye(3), floor_points=points)
    scene = Model(bodies=[body], time_step=1.0 / 960.0)
    state = State.at_rest(
        scene,
        q_WB=q_WO.expand(1, 1, 4),
        p_WB=(0.0, 0.0, 0.025 + PROTRUSION),
        V_WB=torch.tensor([[[0.0, 0.0, w, 0.0, 0.0, 0.0]]], dtype=torch.float64),
    )
    theta = Parameters.nominal(scene, friction_floor=mu)
    rolled = Stepper(scene).rollout(theta, state, torch.zeros(24, 1, 6, dtype=torch.float64))
    torque = mu * 0.5 * 9.81 * float(np.linalg.norm(samples, axis=1).mean())
    assert w - float(rolled.V_WB[-1, 0, 0, 2]) == pytest.approx(torque / moment * 24 / 960, rel=0.02)


def test_corners_are_spread_as_far_as_the_closed_form_says():
    # Root mean squares along a side a: a / 2 at the corners, a / sqrt(12) on an even face.
    x, y, z = corner_spread(trimesh.creation.box((0.06, 0.1, 0.04)), UPRIGHT)
    assert (x, y) == pytest.approx((math.sqrt(3), math.sqrt(3)), rel=0.05)
    assert z == 1.0
    assert corner_spread(trimesh.creation.icosphere(radius=0.05), UPRIGHT) == (1.0, 1.0, 1.0)


@pytest.mark.parametrize("tilt", [(0.0, 0.0, 0.0), (np.pi / 2, 0.0, 0.0), (np.pi, 0.0, 0.0)])
def test_a_face_carries_on_the_same_points_at_any_yaw(tilt):
    mesh = trimesh.creation.box((0.1, 0.06, 0.04))
    resting = Rotation.from_euler("xyz", tilt)
    expected = supporting_points(mesh, resting.as_matrix())
    for yaw in (0.3, 2.0, -1.0):
        found = supporting_points(mesh, (Rotation.from_rotvec([0.0, 0.0, yaw]) * resting).as_matrix())
        np.testing.assert_allclose(found, expected, atol=1e-12)
    down = expected[expected[:, 3] == IF_FLAT][:12]
    np.testing.assert_allclose(down[:, 4:], np.tile(-resting.as_matrix()[2], (12, 1)), atol=1e-9)
