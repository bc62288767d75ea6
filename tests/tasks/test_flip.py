# SPDX-License-Identifier: MIT
import math

import numpy as np
import pytest
import torch
from pydrake.common.eigen_geometry import AngleAxis, Quaternion
from pydrake.math import RollPitchYaw, RotationMatrix

from pinwm_drake.errors import ParameterError
from pinwm_drake.tasks.flip import FlipTask
from pinwm_drake.tasks.push import PushTask
from pinwm_drake.tasks.recipes.flip import FLIP
from pinwm_drake.tasks.registry import task_from_document

UP, SIDE = (0.0, 0.6, -0.8), (1.0, 0.2, 0.1)
CUBE = 0.03 * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])


def rows(number, seed=0):
    generator = np.random.default_rng(seed)
    q_WO = generator.normal(size=(number, 4))
    q_WO /= np.linalg.norm(q_WO, axis=1)[:, None]
    return np.column_stack([q_WO, generator.uniform(-0.3, 0.3, (number, 9))]), generator.uniform(-0.3, 0.3, (number, 3))


def lying(tilt=0.0, z=0.03, speed=0.0, turn=0.0):
    """State of a cube whose -x axis is tilted from the world's z."""
    R_WO = RotationMatrix(AngleAxis(tilt, [1.0, 0.0, 0.0])) @ RotationMatrix.MakeYRotation(math.pi / 2)
    return [*R_WO.ToQuaternion().wxyz(), 0.1, 0.2, z, turn, 0.0, 0.0, 0.0, 0.0, speed]


def cube(**changes):
    return FlipTask(up=(-1.0, 0.0, 0.0), **changes).placed((1.0, 0.0, 0.0, 0.0), CUBE, 0.0)


def measured(task, row):
    return task.measure(np.array([row]), np.array([[0.1, 0.2, 0.33]]))


def test_the_angle_is_that_of_the_axis_from_upright():
    states, p_WP = rows(20)
    progress = FlipTask(up=UP, side=SIDE).measure(states, p_WP)
    wanted = [math.acos((RotationMatrix(Quaternion(wxyz=row[:4])).matrix() @ UP)[2]) for row in states]
    np.testing.assert_allclose(progress.angle, wanted, atol=1e-7)


def test_the_height_at_the_goal_is_that_of_the_lowest_vertex():
    wedge = np.array([[0.0, 0.0, -0.02], [0.05, 0.0, 0.01], [0.0, 0.07, 0.04]])
    assert FlipTask(up=(0.0, 0.0, -2.0)).placed((1.0, 0.0, 0.0, 0.0), wedge, 0.1).height == pytest.approx(0.14)
    assert FlipTask(up=(0.0, 1.0, 0.0)).placed((1.0, 0.0, 0.0, 0.0), wedge, 0.1).height == pytest.approx(0.1)
    assert PushTask().placed((0.6, 0.8, 0.0, 0.0), wedge, 0.1).q_WO == (0.6, 0.8, 0.0, 0.0)


@pytest.mark.parametrize(
    ("changes", "success"),
    [
        ({}, True),
        ({"tilt": 0.199}, True),
        ({"tilt": -0.201}, False),
        ({"z": 0.0399}, True),
        ({"z": 0.0401}, False),
        ({"speed": 0.021}, False),
        ({"turn": 0.31}, False),
    ],
)
def test_success_is_upright_on_the_floor_and_at_rest(changes, success):
    assert measured(cube(), lying(**changes)).success == [success]


def test_the_papers_reward_is_minus_height_and_angle():
    progress = measured(cube(), lying(tilt=0.5, z=0.05))
    np.testing.assert_allclose(cube().rewards(progress, progress), [-0.52], atol=1e-7)


def test_the_shaped_reward_is_of_angle_and_reach_and_pays_success():
    task = cube(reward="shaped", room=0.25)
    far, near = measured(task, lying(tilt=1.0)), measured(task, lying())
    # The pusher is 0.3 m above the object both times.
    np.testing.assert_allclose(task.rewards(far, near), [2.0 - task.cost + task.bonus], atol=1e-6)
    away = task.measure(np.array([lying(tilt=1.0)]), np.array([[0.1, 0.2, 0.43]]))
    np.testing.assert_allclose(task.rewards(far, away), [-0.2 - task.cost], atol=1e-6)


def test_the_shaped_reward_is_less_for_what_turns_while_it_is_upright():
    task = cube(reward="shaped")
    calm, turning, fast = (measured(task, lying(tilt=0.3, turn=turn)) for turn in (0.0, 5.0, 50.0))
    np.testing.assert_allclose(task.rewards(turning, calm), [0.2 * 5.0 * (1.0 - 0.3 / 0.6) - task.cost], atol=1e-6)
    np.testing.assert_allclose(task.rewards(fast, turning), [0.5 - task.cost], atol=1e-6)
    far, turning = (measured(task, lying(tilt=0.7, turn=turn)) for turn in (0.0, 5.0))
    np.testing.assert_allclose(task.rewards(far, turning), [-task.cost], atol=1e-6)


@pytest.mark.parametrize(("room", "share"), [(0.25, 1.0), (0.2, 2.0 - math.hypot(0.1, 0.2) / 0.2), (0.1, 0.0)])
def test_a_success_far_from_the_middle_of_the_floor_is_worth_less(room, share):
    task = cube(reward="shaped", room=room)
    far, near = measured(task, lying(tilt=1.0)), measured(task, lying())
    np.testing.assert_allclose(task.worth(near), [share], atol=1e-9)
    np.testing.assert_allclose(task.rewards(far, near), [2.0 - task.cost + share * task.bonus], atol=1e-6)
    assert near.success.all()  # as a success it counts all the same


@pytest.mark.parametrize("side", [SIDE, (0.0, 0.0, 0.0)])
def test_the_state_tells_object_and_pusher(side):
    task = FlipTask(up=UP, side=side, height=0.05)
    states, p_WP = rows(10)
    found, pusher = task.object_state(task.state(states, p_WP))
    np.testing.assert_allclose(found[:, 4:], states[:, 4:], atol=1e-6)
    np.testing.assert_allclose(pusher, p_WP, atol=1e-6)
    for row, wanted in zip(found, states, strict=True):
        R, R_WO = (RotationMatrix(Quaternion(wxyz=one[:4] / np.linalg.norm(one[:4]))).matrix() for one in (row, wanted))
        np.testing.assert_allclose(R @ UP, R_WO @ UP, atol=1e-5)
        if any(side):
            np.testing.assert_allclose(R, R_WO, atol=1e-5)


def test_the_states_of_a_push_tell_object_and_pusher():
    q_WO = RollPitchYaw(0.3, -1.2, 0.0).ToQuaternion().wxyz()
    task = PushTask(goal=(0.1, -0.2, 0.7), q_WO=tuple(q_WO))
    states, p_WP = rows(10)
    for k, yaw in enumerate(np.linspace(-3.0, 3.0, 10)):
        R_WO = RotationMatrix.MakeZRotation(yaw) @ RotationMatrix(Quaternion(wxyz=q_WO / np.linalg.norm(q_WO)))
        states[k, :4] = R_WO.ToQuaternion().wxyz()
    found, pusher = task.object_state(task.state(states, p_WP))
    np.testing.assert_allclose(np.abs((found[:, :4] * states[:, :4]).sum(1)), 1.0, atol=1e-6)
    np.testing.assert_allclose(found[:, [4, 5, 9, 10, 11]], states[:, [4, 5, 9, 10, 11]], atol=1e-6)
    np.testing.assert_allclose(pusher[:, :2], p_WP[:, :2], atol=1e-6)
    assert np.isnan(found[:, 6]).all()
    assert np.isnan(pusher[:, 2]).all()


@pytest.mark.parametrize("side", [SIDE, (0.0, 0.0, 0.0)])
def test_what_a_network_estimates_makes_the_state(side):
    task, low, high = FlipTask(up=UP, side=side, height=0.05), np.array([-0.4, -0.3, 0.01]), np.array([0.3, 0.3, 0.3])
    states, p_WP = rows(5)
    state = task.state(states, p_WP)
    module = FLIP.assembly(task, low, high)
    estimate = state[:, : module.estimate_size].copy()
    estimate[:, 3:6] *= 3.0
    pusher = 2.0 * (p_WP - low) / (high - low) - 1.0
    made = module(torch.from_numpy(estimate), torch.from_numpy(pusher).float())
    np.testing.assert_allclose(made.numpy(), state, atol=1e-5)


def test_nearness_by_a_state_is_that_of_the_axis():
    task = cube()
    for tilt, near in ((0.19, True), (0.21, False), (math.pi, False)):
        state = task.state(np.array([lying(tilt=tilt, turn=1.0)]), np.zeros((1, 3)))[0]
        assert task.near_goal(state) is near
        assert FLIP.estimate_words(task, state) == f"{math.degrees(tilt):.0f} deg from upright"
    assert not task.near_goal(np.full(18, np.nan))


def test_each_component_of_the_state_is_told_with_its_unit():
    words = [words for words, _ in FlipTask().state_components()]
    assert len(set(words)) == len(words) == FlipTask.state_size


def test_a_document_brings_the_task_back():
    task = FlipTask(up=UP, side=SIDE, height=0.07, reward="shaped", turn_tolerance=0.1)
    assert task_from_document(task.to_document()) == task


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"reward": "sparse"}, "reward: got 'sparse'; allowed: paper, shaped"),
        ({"up": (0.0, 0.0, 0.0)}, "up: got"),
        ({"side": (0.0, 0.0, 2.0)}, "side: got"),
        ({"side": (0.0, math.nan, 2.0)}, "side: got"),
        ({"height": math.inf}, "height: got inf"),
        ({"rest_turn": 0.0}, "rest_turn: got 0.0; allowed: more than 0"),
    ],
)
def test_what_cannot_be_is_refused(options, words):
    with pytest.raises(ParameterError, match=words):
        FlipTask(**options)


@pytest.mark.parametrize("name", [None, {"a": 1}, ["flip"], 3, "fold"])
def test_a_document_of_no_known_task_is_refused(name):
    with pytest.raises(ParameterError, match=r"task: got .*; allowed: a mapping whose name is one of flip, push"):
        task_from_document({"name": name})
