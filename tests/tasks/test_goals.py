# SPDX-License-Identifier: MIT
import numpy as np
import pytest
import torch
from pydrake.common.eigen_geometry import Quaternion
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix

from pinwm_drake.errors import ParameterError
from pinwm_drake.tasks.flip import FlipTask
from pinwm_drake.tasks.push import PushTask
from pinwm_drake.tasks.recipes.push import PUSH
from pinwm_drake.tasks.registry import task_from_document

LOW, HIGH = np.array([-0.3, -0.2]), np.array([0.4, 0.35])
TASK = PushTask(goal=(0.02, -0.03, 0.4), q_WO=(0.8, 0.6, 0.0, 0.0), goal_range=(0.1, 0.1, np.pi))


def poses(generator, number):
    """Object states (n, 13) and pushers (n, 3), turned about z from the task's orientation, and goals (n, 3)."""
    yaw = generator.uniform(-np.pi, np.pi, number)
    q_WO = np.stack([wxyz(RotationMatrix.MakeZRotation(a) @ turn(TASK.q_WO)) for a in yaw])
    place = generator.uniform(-0.2, 0.2, (number, 3))
    velocities = generator.normal(0.0, 0.2, (number, 6))
    pusher = generator.uniform(-0.2, 0.3, (number, 3))
    goals = np.stack([TASK.draw_goal(generator) for _ in range(number)])
    return np.concatenate([q_WO, place, velocities], axis=1), pusher, goals


def turn(q):
    return RotationMatrix(Quaternion(wxyz=np.array(q) / np.linalg.norm(q)))


def wxyz(R):
    return R.ToQuaternion().wxyz()


def moved(object_state, p_WP, goal):
    """The scene moved along with its goal to the task's own, by Drake."""
    x, y, yaw = TASK.goal
    X_WG, X_WF = (RigidTransform(RollPitchYaw(0, 0, a), [u, v, 0.0]) for u, v, a in (goal, (x, y, yaw)))
    X = X_WF @ X_WG.inverse()
    pose = X @ RigidTransform(turn(object_state[:4]), object_state[4:7])
    velocities = [X.rotation() @ object_state[7:10], X.rotation() @ object_state[10:13]]
    return np.concatenate([wxyz(pose.rotation()), pose.translation(), *velocities]), X @ p_WP


def test_a_scene_is_seen_from_a_goal_as_if_all_of_it_were_moved():
    object_state, p_WP, goals = poses(np.random.default_rng(0), 20)
    expected = [moved(*one) for one in zip(object_state, p_WP, goals, strict=True)]
    wanted, pusher = np.stack([one[0] for one in expected]), np.stack([one[1] for one in expected])
    found, found_pusher = TASK.from_goal(object_state, p_WP, goals)
    sign = np.sign((found[:, :4] * wanted[:, :4]).sum(1))
    wanted[:, :4] *= sign[:, None]
    np.testing.assert_allclose(found, wanted, atol=1e-12)
    np.testing.assert_allclose(found_pusher, pusher, atol=1e-12)


def test_progress_and_state_are_those_of_a_task_with_that_goal_alone():
    object_state, p_WP, goals = poses(np.random.default_rng(1), 20)
    object_state[:5, 4:6] = goals[:5, :2]  # some are there
    moved_state, moved_pusher = TASK.from_goal(object_state, p_WP, goals)
    together = TASK.measure(moved_state, moved_pusher)
    for k, goal in enumerate(goals):
        alone = TASK.with_goal(goal)
        assert alone.goal_size == 0
        progress = alone.measure(object_state[k : k + 1], p_WP[k : k + 1])
        assert together.distance[k] == pytest.approx(progress.distance[0], abs=1e-9)
        assert together.angle[k] == pytest.approx(progress.angle[0], abs=1e-6)
        state = alone.state(object_state[k : k + 1], p_WP[k : k + 1])[0]
        np.testing.assert_allclose(TASK.state(moved_state, moved_pusher)[k], state, atol=2e-5)


def test_the_estimate_of_an_object_in_the_world_is_told_from_any_goal():
    object_state, p_WP, goals = poses(np.random.default_rng(2), 20)
    assembly = PUSH.assembly(TASK, LOW, HIGH)
    own = TASK.with_goal(np.array(TASK.goal))
    estimate = torch.from_numpy(own.state(object_state, p_WP)[:, :7])
    pusher = torch.from_numpy((2.0 * (p_WP[:, :2] - LOW) / (HIGH - LOW) - 1.0).astype(np.float32))
    expected = TASK.state(*TASK.from_goal(object_state, p_WP, goals))
    found = assembly(estimate, pusher, goal=torch.from_numpy(goals.astype(np.float32)))
    np.testing.assert_allclose(found.numpy(), expected, atol=1e-4)
    np.testing.assert_allclose(assembly(estimate, pusher).numpy(), own.state(object_state, p_WP), atol=1e-4)


def test_an_action_towards_the_own_goal_is_turned_with_the_goal_and_no_longer_than_one():
    goal = torch.tensor([[0.3, 0.1, TASK.goal[2] + np.pi / 2], [0.0, 0.0, TASK.goal[2]]], dtype=torch.float32)
    found = TASK.world_action(torch.tensor([[1.0, 0.0], [1.0, 1.0]]), goal)
    np.testing.assert_allclose(found.numpy(), [[0.0, 1.0], [0.5**0.5, 0.5**0.5]], atol=1e-6)


def test_goals_are_drawn_within_the_range_and_a_document_keeps_it():
    generator = np.random.default_rng(3)
    goals = np.stack([TASK.draw_goal(generator) for _ in range(500)]) - TASK.goal
    assert (np.abs(goals) <= TASK.goal_range).all()
    assert (np.abs(goals).max(0) > 0.9 * np.array(TASK.goal_range)).all()
    assert task_from_document(TASK.to_document()) == TASK
    assert len(TASK.goal_components()) == TASK.goal_size == 3


def test_a_task_without_a_range_is_as_it_was_before_there_was_one():
    task = PushTask()
    assert "goal_range" not in task.to_document()
    assert task.goal_size == len(task.goal_components()) == 0
    assert task.draw_goal(np.random.default_rng(0)).shape == (0,)
    assert task.with_goal(np.zeros(0)) is task
    assert FlipTask().goal_size == 0


@pytest.mark.parametrize("goal_range", [(0.1, 0.1), (-0.1, 0.0, 0.0), (0.0, 0.0, float("nan"))])
def test_a_range_that_makes_no_sense_is_refused(goal_range):
    with pytest.raises(ParameterError, match="goal_range"):
        PushTask(goal_range=goal_range)
