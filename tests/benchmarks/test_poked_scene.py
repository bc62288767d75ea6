# SPDX-License-Identifier: MIT
"""A pusher that goes anywhere, in engines that are not ours, against closed forms."""

import importlib

import numpy as np
import pytest
from pydrake.common.eigen_geometry import Quaternion
from pydrake.math import RigidTransform, RotationMatrix

from pinwm_drake.geometry.stored_pieces import mesh_pieces
from pinwm_drake.systems.scenario.load import load_setup

HALF, RADIUS, FRICTION = 0.03, 0.01, 0.2  # m; of the cube that ships


@pytest.fixture(params=["mujoco", "bullet"])
def make(request):
    """Maker of a cube at rest, by the pusher's place."""
    pytest.importorskip({"mujoco": "mujoco", "bullet": "pybullet"}[request.param])
    engine = importlib.import_module(f"benchmarks.next_push.engines.{request.param}")
    rollout = importlib.import_module("benchmarks.next_push.engines.rollout")
    objects = importlib.import_module("benchmarks.next_push.objects")
    twin = load_setup("flip_cube").twin
    path = twin.mesh_path
    assert twin.theta["friction_floor"].value == FRICTION
    hulls = tuple(np.asarray(piece.vertices) for piece in mesh_pieces(path))
    thing = objects.StandingAnyhow(twin.name, path, path, (), hulls)
    X_WO = RigidTransform(RotationMatrix.MakeZRotation(0.0), [0.0, 0.0, HALF])
    theta, shape = rollout.twin_truth(twin), twin.pusher.shape
    return lambda p_WP: engine.PokedScene(thing, theta, X_WO, rollout.Tip(shape, np.array(p_WP)))


def test_a_cube_is_pushed_as_fast_as_the_pusher_and_slides_to_rest(make):
    scene = make([-HALF - RADIUS - 0.01, 0.0, HALF])
    scene.advance(np.array([0.3, 0.0, 0.0]), 0.2)
    pushed = scene.object_state
    np.testing.assert_allclose(scene.p_WP, [-HALF - RADIUS - 0.01 + 0.06, 0.0, HALF], atol=1e-3)
    np.testing.assert_allclose(pushed[4:7], [0.05, 0.0, HALF], atol=2e-3)
    np.testing.assert_allclose(pushed[10:13], [0.3, 0.0, 0.0], atol=0.03)
    scene.advance(np.array([-0.3, 0.0, 0.0]), 0.3)
    rest = scene.object_state
    assert rest[4] - pushed[4] == pytest.approx(0.3**2 / (2 * FRICTION * 9.81), abs=3e-3)
    assert np.abs(rest[7:]).max() < 5e-3


def test_velocities_are_those_of_the_motion_in_the_world(make):
    scene = make([-HALF - RADIUS - 1e-3, 0.02, 0.05])
    scene.advance(np.array([0.6, 0.0, 0.4]), 0.06)
    before = scene.object_state
    scene.advance(np.array([0.6, 0.0, 0.4]), 0.004)
    after = scene.object_state
    R, R_after = (RotationMatrix(Quaternion(wxyz=one[:4])) for one in (before, after))
    turned = (R_after @ R.inverse()).ToAngleAxis()
    rate = turned.angle() * turned.axis() / 0.004
    assert np.linalg.norm(rate) > 1.0
    np.testing.assert_allclose(0.5 * (before + after)[7:10], rate, atol=0.1 * np.linalg.norm(rate))
    np.testing.assert_allclose(0.5 * (before + after)[10:13], (after - before)[4:7] / 0.004, atol=0.05)
