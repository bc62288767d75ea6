# SPDX-License-Identifier: MIT
import itertools
import math

import numpy as np
import pytest
from pydrake.common.eigen_geometry import Quaternion
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix

from pinwm_drake.errors import ParameterError
from pinwm_drake.tasks.push import PushTask
from pinwm_drake.tasks.recipes.push import PUSH


def row(x=0.0, y=0.0, yaw=0.0, roll=0.0, speed=0.0, turn=0.0):
    q_WO = RollPitchYaw(roll, 0.0, yaw).ToQuaternion().wxyz()
    return [*q_WO, x, y, 0.025, 0.0, 0.0, turn, speed, 0.0, 0.0]


def measured(task, *rows, p_WP=(0.0, 0.3, 0.025)):
    return task.measure(np.array(rows), np.tile(p_WP, (len(rows), 1)))


def test_the_distances_of_known_poses():
    task = PushTask(goal=(0.1, -0.2, 0.5))
    progress = measured(task, row(0.1, -0.2, 0.5), row(0.13, -0.16, -0.2), row(0.1, -0.2, 0.5 + math.pi))
    np.testing.assert_allclose(progress.distance, [0.0, 0.05, 0.0], atol=1e-15)
    # arccos near 1 loses half of the digits.
    np.testing.assert_allclose(progress.angle, [0.0, 0.7, math.pi], atol=1e-7)


def test_a_quaternion_and_its_negative_are_one_orientation():
    one, other = np.array(row(yaw=0.3)), np.array(row(yaw=0.3))
    other[:4] *= -1
    np.testing.assert_array_equal(*measured(PushTask(), one, other).angle[:, None])


def test_a_block_that_lies_on_its_side_is_not_at_the_goal():
    assert measured(PushTask(), row(roll=math.pi / 2)).angle == pytest.approx(math.pi / 2)
    lying = tuple(RollPitchYaw(math.pi / 2, 0.0, 0.0).ToQuaternion().wxyz())
    assert measured(PushTask(q_WO=lying), row(roll=math.pi / 2)).angle == pytest.approx(0.0, abs=1e-7)


@pytest.mark.parametrize(
    ("changes", "success"),
    [
        ({}, True),
        ({"x": 0.0199}, True),
        ({"x": 0.0201}, False),
        ({"yaw": 0.199}, True),
        ({"yaw": -0.201}, False),
        ({"speed": 0.006}, False),
        ({"turn": -0.06}, False),
    ],
)
def test_success_is_near_turned_little_and_at_rest(changes, success):
    assert measured(PushTask(), row(**changes)).success == [success]


def test_the_papers_reward_is_minus_both_distances():
    task = PushTask()
    progress = measured(task, row(0.03, 0.04, 0.7))
    np.testing.assert_allclose(task.rewards(measured(task, row()), progress), [-0.75], atol=1e-7)


def test_the_shaped_rewards_of_a_path_add_up_to_the_potentials_of_its_ends():
    task = PushTask(reward="shaped")
    generator = np.random.default_rng(0)
    path = [measured(task, row(*generator.uniform(0.05, 0.5, 3)), p_WP=generator.uniform(-1, 1, 3)) for _ in range(9)]
    total = sum(task.rewards(before, after) for before, after in itertools.pairwise(path))
    first, last = (10 * at.distance + at.angle + 2 * np.maximum(at.reach - 0.1, 0.0) for at in (path[0], path[-1]))
    np.testing.assert_allclose(total, first - last - 8 * task.cost, rtol=1e-12)


def test_in_training_success_is_nearer_than_where_it_is_judged():
    task = PushTask(tolerance=0.02, turn_tolerance=0.2)
    assert task.for_training() == PushTask(reward="shaped", tolerance=0.9 * 0.02, turn_tolerance=0.9 * 0.2)


def test_the_shaped_reward_pays_for_success_once():
    task = PushTask(reward="shaped")
    there = measured(task, row())
    np.testing.assert_allclose(task.rewards(there, there), [task.bonus - task.cost])


def test_the_goals_pose():
    goal = PushTask(goal=(0.1, 0.2, 0.3), q_WO=tuple(RollPitchYaw(0.4, 0.0, 0.0).ToQuaternion().wxyz()))
    pose = goal.goal_pose(0.025)
    X_WG = RigidTransform(Quaternion(wxyz=pose.q.numpy()), pose.p.numpy())
    expected = RotationMatrix.MakeZRotation(0.3) @ RotationMatrix.MakeXRotation(0.4)
    assert X_WG.IsNearlyEqualTo(RigidTransform(expected, [0.1, 0.2, 0.025]), 1e-12)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"reward": "sparse"}, "reward: got 'sparse'; allowed: paper, shaped"),
        ({"goal": (0.0, math.nan, 0.0)}, "goal: got"),
        ({"tolerance": 0.0}, "tolerance: got 0.0; allowed: more than 0"),
        ({"q_WO": (0.0, 0.0, 0.0, 0.0)}, "q_WO: got"),
        ({"bonus": math.inf}, "bonus: got inf; allowed: a finite number"),
    ],
)
def test_what_cannot_be_is_refused(options, words):
    with pytest.raises(ParameterError, match=words):
        PushTask(**options)


@pytest.mark.parametrize(
    ("x", "y", "yaw", "near"),
    [
        (0.0, 0.0, 0.0, True),
        (0.012, -0.0159, 0.199, True),
        (0.0, 0.0201, 0.0, False),
        (0.0, 0.0, 0.201, False),
        (0.0, 0.0, -0.201, False),
        (0.0, 0.0, math.pi, False),
    ],
)
def test_nearness_by_a_state_is_that_of_the_pose(x, y, yaw, near):
    task = PushTask(goal=(0.1, -0.2, 0.5))
    moved = RigidTransform(RollPitchYaw(0, 0, 0.5), [0.1, -0.2, 0.0]) @ np.array([x, y, 0.0])
    state = task.state(np.array([row(moved[0], moved[1], 0.5 + yaw, speed=0.1)]), np.array([[0.0, 0.3, 0.025]]))[0]
    assert task.near_goal(state) is near  # at any speed
    turned = f"{abs(math.degrees(yaw)):.1f}"
    assert PUSH.estimate_words(task, state) == f"{1e3 * math.hypot(x, y):.0f} mm, {turned} deg from the goal"


def test_a_state_that_is_no_number_is_not_near():
    state = np.array([0.0, 0.0, 1.0, *np.zeros(8)])
    assert PushTask().near_goal(state)
    for k in range(4):
        broken = state.copy()
        broken[k] = np.nan
        assert not PushTask().near_goal(broken)


def test_each_component_of_the_state_is_told_with_its_unit():
    task = PushTask()
    units = [unit for _, unit in task.state_components()]
    assert len({words for words, _ in task.state_components()}) == task.state_size
    # A metre, a metre a second, a radian a second: the state has so many units of each.
    state = task.state(np.array([row(1.0, 0.0, speed=1.0, turn=1.0)]), np.array([[0.0, 1.0, 0.025]]))[0]
    scale = {"0.1 m": 10.0, "0.3 m/s": 1 / 0.3, "3 rad/s": 1 / 3.0, "1": 1.0}
    assert [state[k] for k in (0, 4, 6, 10)] == pytest.approx([scale[units[k]] for k in (0, 4, 6, 10)])
