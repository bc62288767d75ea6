# SPDX-License-Identifier: MIT
import math

import numpy as np
import pytest
from pydrake.common.eigen_geometry import Quaternion
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix

from pinwm_drake.errors import ParameterError
from pinwm_drake.systems.envs.observation import Observer
from pinwm_drake.tasks.push import PushTask
from tests.systems.stations import action_setup, setup_of


def setup(worlds=1, **task):
    return action_setup(setup_of(), num_worlds=worlds, task=task)


def row(X_WO, w_WO=(0.0, 0.0, 0.0), v_WO=(0.0, 0.0, 0.0)):
    return np.array([*X_WO.rotation().ToQuaternion().wxyz(), *X_WO.translation(), *w_WO, *v_WO])


def test_the_state_of_a_known_pose():
    observer = Observer(setup(goal=(0.1, 0.0, math.pi / 2)), "state")
    X_WO = RigidTransform(RollPitchYaw(0.0, 0.0, math.pi), [0.1, 0.05, 0.025])
    seen = observer.observe(row(X_WO, (0.0, 0.0, 1.5), (0.3, 0.0, 0.0))[None], np.array([[0.2, 0.05, 0.025]]))
    # The goal's x is the world's y, its y the world's -x; the object's x is the world's -x.
    expected = [0.5, 0.0, 0.0, 1.0, 0.0, -1.0, 0.5, -1.0, 0.0, 0.5, -1.0]
    np.testing.assert_allclose(seen, [expected], atol=1e-6)
    assert observer.space.contains(seen[0])


def test_the_state_does_not_see_where_the_scene_stands():
    generator = np.random.default_rng(1)
    X_WO = RigidTransform(RollPitchYaw(0.0, 0.0, 0.7), [0.03, -0.02, 0.025])
    p_WP, V = np.array([0.1, 0.05, 0.025]), generator.normal(size=(2, 3))
    yaw, shift = 1.1, np.array([0.2, -0.3, 0.0])
    R = RotationMatrix.MakeZRotation(yaw)
    moved = RigidTransform(R, shift)
    here = PushTask().state(row(X_WO, *V)[None], p_WP[None])
    there = PushTask(goal=(*shift[:2], yaw)).state(row(moved @ X_WO, R @ V[0], R @ V[1])[None], (moved @ p_WP)[None])
    np.testing.assert_allclose(there, here, atol=1e-5)


def test_the_yaw_is_the_turn_after_the_lying_orientation():
    lying = RotationMatrix(RollPitchYaw(math.pi / 2, 0.0, 0.0))
    task = PushTask(q_WO=tuple(lying.ToQuaternion().wxyz()))
    X_WO = RigidTransform(RotationMatrix.MakeZRotation(0.4) @ lying, [0.0, 0.0, 0.04])
    state = task.state(row(X_WO)[None], np.zeros((1, 3)))
    np.testing.assert_allclose(state[0, 2:4], [math.cos(0.4), math.sin(0.4)], atol=1e-6)
    assert Quaternion(task.q_WO).wxyz() == pytest.approx(task.q_WO)


def test_what_is_far_or_no_number_stays_within_the_space():
    observer = Observer(setup(), "state")
    far = row(RigidTransform([1e6, 0.0, 0.0]))
    broken = np.full(13, np.nan)
    for state in (far, broken):
        assert observer.space.contains(observer.observe(state[None], np.zeros((1, 3)))[0])


def pictures(worlds, value):
    camera = setup().camera
    return np.full((worlds, camera.height, camera.width, 4), value, np.uint8)


@pytest.mark.parametrize("frames", [1, 3])
def test_the_last_images_are_seen_the_oldest_first(frames):
    observer = Observer(setup(2), "rgb", frames)
    state, p_WP = np.tile(row(RigidTransform()), (2, 1)), np.zeros((2, 3))
    observer.begin(np.array([0, 1]), pictures(2, 10))
    for value in (20, 30):
        observer.see(pictures(2, value))
    observer.begin(np.array([1]), pictures(1, 99))
    image = observer.observe(state, p_WP)["image"]
    assert image.shape == (2, 80, 96, 3 * frames)
    seen = image[:, 0, 0].reshape(2, frames, 3)
    assert (seen == seen[..., :1]).all()
    assert seen[..., 0].tolist() == [[10, 20, 30][-frames:], [99] * frames]


def test_an_observation_is_not_changed_by_the_next():
    observer = Observer(setup(), "rgb")
    state, p_WP = row(RigidTransform())[None], np.zeros((1, 3))
    observer.begin(np.array([0]), pictures(1, 10))
    first = observer.observe(state, p_WP)["image"]
    observer.see(pictures(1, 20))
    observer.begin(np.array([0]), pictures(1, 30))
    assert (first == 10).all()


def test_the_pusher_is_where_it_is_in_its_box():
    observer = Observer(setup(3), "rgb_state")
    state = np.tile(row(RigidTransform()), (3, 1))
    seen = observer.observe(state, np.array([[0.4, -0.4, 0.0], [0.0, 0.2, 0.0], [0.9, 0.0, 0.0]]))
    np.testing.assert_allclose(seen["pusher"], [[1.0, -1.0], [0.0, 0.5], [1.0, 0.0]], atol=1e-7)
    assert seen["state"].shape == (3, 11)
    assert set(observer.space.spaces) == {"image", "pusher", "state"}


@pytest.mark.parametrize(("kind", "frames", "words"), [("depth", 1, "state, rgb, rgb_state"), ("rgb", 0, "1 or more")])
def test_what_cannot_be_is_refused(kind, frames, words):
    with pytest.raises(ParameterError, match=words):
        Observer(setup(), kind, frames)
