import dataclasses
import math

import numpy as np
import pytest
from pydrake.common.eigen_geometry import Quaternion
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix

from pinwm_drake.errors import ParameterError
from pinwm_drake.systems.envs.env import TaskEnv
from pinwm_drake.systems.envs.miscalibration import Miscalibration
from pinwm_drake.systems.envs.vector import TaskVecEnv

MOST = (0.02, math.radians(3))
X_WC = RigidTransform(RollPitchYaw(2.1, 0.2, -0.7), [0.3, -0.4, 0.5])


def pose_of(state):
    return RigidTransform(RotationMatrix(Quaternion(wxyz=state[:4])), state[4:7])


def test_what_is_seen_is_what_the_camera_would_show_if_it_were_where_it_is_believed_to_be():
    generator = np.random.default_rng(0)
    camera = Miscalibration(MOST, X_WC, 5)
    true = [camera.begin(world, generator) for world in range(5)]
    state = generator.normal(size=(5, 13))
    state[:, :4] /= np.linalg.norm(state[:, :4], axis=1, keepdims=True)
    seen = camera.seen(state)
    for world in range(5):
        in_camera = true[world].inverse() @ pose_of(state[world])
        assert (X_WC.inverse() @ pose_of(seen[world])).IsNearlyEqualTo(in_camera, 1e-12)
        turn = true[world].rotation() @ X_WC.rotation().inverse()
        for part in (slice(7, 10), slice(10, 13)):
            np.testing.assert_allclose(turn @ seen[world, part], state[world, part], atol=1e-12)


def test_cameras_are_off_by_as_much_as_is_allowed_in_any_direction():
    generator, camera = np.random.default_rng(1), Miscalibration(MOST, X_WC, 1)
    off = [X_WC.inverse() @ camera.begin(0, generator) for _ in range(2000)]
    moves = np.array([X.translation() for X in off])
    turns = np.array([X.rotation().ToAngleAxis().angle() for X in off])
    for sizes, most in ((np.linalg.norm(moves, axis=1), MOST[0]), (turns, MOST[1])):
        assert sizes.max() <= most * (1 + 1e-9)
        np.testing.assert_allclose(np.quantile(sizes, [0.25, 0.5, 0.75]) / most, [0.25, 0.5, 0.75], atol=0.05)
    np.testing.assert_allclose(moves.mean(axis=0) / MOST[0], 0.0, atol=0.05)


@pytest.mark.parametrize("most", [(-1e-3, 0.0), (0.0, -0.1), (math.nan, 0.0), (0.0, 3.2), (math.inf, 0.0)])
def test_an_error_that_makes_no_sense_is_refused(most):
    with pytest.raises(ParameterError, match="camera_error"):
        Miscalibration(most, X_WC, 1)


def test_the_images_of_a_world_are_those_of_a_camera_that_stands_where_it_is():
    env = TaskVecEnv("flip_mug", 3, observation="rgb_state", image_size=64, camera_error=MOST)
    env.seed(2)
    image = env.reset()["image"]
    setup = env.worlds.setup
    seen = env.worlds._seen_state
    for world in range(3):
        # X_seen = X_WC X_CE⁻¹ X_WC⁻¹ X_WO
        X_WO, X_seen = pose_of(env.worlds.run.object_state[world]), pose_of(seen[world])
        X_WE = X_WO @ X_seen.inverse() @ setup.X_WC
        off = setup.X_WC.inverse() @ X_WE
        assert 0.0 < np.linalg.norm(off.translation()) <= MOST[0]
        there = dataclasses.replace(setup, X_WC=X_WE, scenario=dataclasses.replace(setup.scenario, num_worlds=1))
        alone = TaskEnv(there, "twin", observation="rgb", image_size=64)
        found, _ = alone.reset(options={"X_WO": X_WO, "p_WP": env.worlds.run.p_WP[world]})
        assert (found["image"] != image[world]).mean() < 1e-3  # rounding
        usual = TaskEnv(dataclasses.replace(there, X_WC=setup.X_WC), "twin", observation="rgb", image_size=64)
        found, _ = usual.reset(options={"X_WO": X_WO, "p_WP": env.worlds.run.p_WP[world]})
        assert (found["image"] != image[world]).mean() > 1e-2


def test_the_state_that_a_teacher_sees_is_that_of_the_images_and_success_is_that_of_the_object():
    env = TaskVecEnv("push_t", 2, observation="state", camera_error=(0.0, 0.05))
    env.seed(0)
    state = env.reset()
    task, worlds = env.worlds.task, env.worlds
    true, seen = worlds.run.object_state, worlds._seen_state
    assert np.abs(true[:, 4:7] - seen[:, 4:7]).max() > 1e-3
    np.testing.assert_allclose(state, task.state(*task.from_goal(seen, worlds.run.p_WP, worlds.goal)))
    measured = task.measure(*task.from_goal(true, worlds.run.p_WP, worlds.goal))
    np.testing.assert_allclose(worlds.progress.distance, measured.distance)


def test_worlds_whose_cameras_are_off_go_on_as_they_were_kept():
    first, second = (
        TaskVecEnv("push_t", 2, observation="rgb_state", image_size=32, camera_error=MOST) for _ in range(2)
    )
    first.seed(5)
    first.reset()
    actions = np.random.default_rng(0).uniform(-1, 1, (3, 2, 2)).astype(np.float32)
    first.step(actions[0])
    second.reset()
    second.set_state(first.get_state())
    for action in actions[1:]:
        one, other = first.step(action)[0], second.step(action)[0]
        for name, values in one.items():
            np.testing.assert_array_equal(values, other[name])


def test_a_plant_has_the_camera_of_its_scene():
    with pytest.raises(ParameterError, match="camera_error"):
        TaskEnv("push_t", "point", camera_error=MOST)
