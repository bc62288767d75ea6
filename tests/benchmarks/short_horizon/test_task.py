"""The push task in torch against the one in numpy, and its worlds against those of the environment."""

import numpy as np
import pytest
import torch

from benchmarks.short_horizon.task import TorchPush
from pinwm_drake.errors import ParameterError
from pinwm_drake.tasks.push import PushTask

TASK = PushTask(goal=(0.02, -0.03, 0.4), q_WO=(0.6, 0.8, 0.0, 0.0)).for_training()


def states(number, near=1.0):
    """Random states of objects and pushers, near the goal with a small `near`."""
    g = np.random.default_rng(3)
    yaw = 0.4 + near * g.uniform(-3.0, 3.0, number)
    c, s = np.cos(0.5 * yaw), np.sin(0.5 * yaw)
    tilt = near * g.normal(0.0, 0.1, (number, 3))
    q = np.column_stack([0.6 * c, 0.8 * c, 0.8 * s, 0.6 * s]) + np.pad(tilt, ((0, 0), (1, 0)))
    q /= np.linalg.norm(q, axis=1, keepdims=True)
    p = np.array([0.02, -0.03, 0.03]) + near * g.normal(0.0, 0.1, (number, 3))
    V = near * g.normal(0.0, 0.3, (number, 6))
    p_WP = p + g.normal(0.0, 0.15, (number, 3))
    return np.concatenate([q, p, V], 1), p_WP


def both(number=200, near=1.0):
    object_state, p_WP = states(number, near)
    return (object_state, p_WP), (torch.from_numpy(object_state), torch.from_numpy(p_WP))


@pytest.mark.parametrize("near", [1.0, 0.02])
def test_progress_and_state_are_those_of_the_task(near):
    arrays, tensors = both(near=near)
    wanted, found = TASK.measure(*arrays), TorchPush(TASK).measure(*tensors)
    for name in ("distance", "angle", "reach"):
        np.testing.assert_allclose(getattr(found, name).numpy(), getattr(wanted, name), atol=3e-8)
    np.testing.assert_array_equal(found.success.numpy(), wanted.success)
    assert wanted.success.any() == (near < 1.0)
    np.testing.assert_allclose(TorchPush(TASK).state(*tensors).numpy(), TASK.state(*arrays), atol=2e-6)


def test_rewards_are_those_of_the_task():
    (before, p_before), tensors_before = both(near=0.05)
    (after, p_after), tensors_after = both(near=0.02)
    ours = TorchPush(TASK)
    progress = ours.measure(*tensors_before), ours.measure(*tensors_after)
    wanted = TASK.rewards(TASK.measure(before, p_before), TASK.measure(after, p_after))
    np.testing.assert_allclose(ours.rewards(*progress).numpy(), wanted, atol=3e-7)
    without = ours.rewards(*progress, bonus=False).numpy()
    np.testing.assert_allclose(wanted - without, TASK.bonus * progress[1].success.numpy(), atol=3e-7)
    assert progress[1].success.any()


def test_gradients_of_state_and_potential_are_those_of_differences():
    _, (object_state, p_WP) = both(8)
    ours = TorchPush(TASK)

    def values(object_state, p_WP):
        progress = ours.measure(object_state, p_WP)
        return torch.stack([progress.distance, progress.angle, progress.reach], 1)

    inputs = object_state.requires_grad_(), p_WP.requires_grad_()
    assert torch.autograd.gradcheck(values, inputs, eps=1e-6, atol=1e-6)


def test_gradients_at_the_goal_are_finite():
    ours = TorchPush(TASK)
    at_goal = torch.tensor([[*TASK.q_WG, *TASK.goal[:2], 0.03, *[0.0] * 6]], requires_grad=True, dtype=torch.float64)
    progress = ours.measure(at_goal, torch.zeros(1, 3, dtype=torch.float64))
    (bar,) = torch.autograd.grad((progress.distance + progress.angle).sum(), at_goal)
    assert bool(progress.success)
    assert bool(torch.isfinite(bar).all())


def test_goals_that_are_drawn_and_other_rewards_are_refused():
    with pytest.raises(ParameterError, match="reward"):
        TorchPush(PushTask())
    with pytest.raises(ParameterError, match="goal_range"):
        TorchPush(PushTask(reward="shaped", goal_range=(0.1, 0.1, 0.0)))
