"""The differentiable worlds against those of the environment, and their gradients against differences."""

import numpy as np
import pytest
import torch

from benchmarks.short_horizon.worlds import PushWorlds
from pinwm_drake.cousins.domain import CousinDomains
from pinwm_drake.errors import ParameterError
from pinwm_drake.systems.envs.training_worlds import TrainingWorlds, training_options

W = 6


@pytest.fixture(scope="module")
def training():
    return TrainingWorlds("push_t", training_options(), num_worlds=W, domains=CousinDomains(delta=0.0))


def test_an_episode_is_that_of_the_environment(training):
    env, ours = training.task_worlds("state"), PushWorlds(training, W, 0)
    env.seed(0)
    seen = env.reset()
    real = env.worlds
    ours.place(real.run.object_state, real.run.p_WP)
    np.testing.assert_allclose(ours.seen().numpy(), seen, atol=2e-6)
    touched = np.zeros(W, bool)
    for _ in range(12):
        # Towards the object, as far as allowed; some worlds beyond it.
        c, s, x, y = seen[:, 2], seen[:, 3], -seen[:, 7], -seen[:, 8]
        action = np.stack([c * x - s * y, s * x + c * y], 1) * np.linspace(0.5, 4.0, W)[:, None]
        seen, reward, ended, _ = env.step(action.clip(-1, 1).astype(np.float32))
        out = ours.advance(torch.from_numpy(action.clip(-1, 1).astype(np.float32)))
        assert not ended.any()
        assert not out.ended.any()
        np.testing.assert_allclose(out.seen.numpy(), seen, atol=2e-5)
        np.testing.assert_allclose(ours.task.rewards(out.before, out.after).numpy(), reward, atol=2e-5)
        touched |= np.abs(seen[:, 4:6]).max(1) > 0.01
    assert touched.all()


def test_the_pusher_stays_in_its_box(training):
    ours = PushWorlds(training, W, 0)
    ours.place(ours.object_state.numpy(), np.tile([0.34, 0.3, 0.025], (W, 1)))
    for _ in range(3):
        ours.advance(torch.tensor([[1.0, 0.0]] * W))
    np.testing.assert_allclose(ours.p_WP.numpy(), np.tile([0.35, 0.3, 0.025], (W, 1)), atol=1e-9)


def test_gradients_through_a_push_are_those_of_differences(training):
    ours = PushWorlds(training, W, 1)
    start = np.tile([1.0, 0, 0, 0, 0.05, 0.03, float(ours.object_state[0, 6]), 0, 0, 0, 0, 0, 0], (W, 1))
    pusher = np.tile([0.05, 0.17, 0.025], (W, 1))
    pusher[:, 0] += np.linspace(-0.012, 0.012, W) + 0.001

    def value(y):
        ours.place(start, pusher)
        total = torch.zeros(W, dtype=torch.float64)
        for k in range(6):
            out = ours.advance(torch.stack([0.1 * torch.ones_like(y), y - 0.05 * k], 1))
            total = total + ours.task.rewards(out.before, out.after)
        return total

    y = torch.full((W,), -0.6, dtype=torch.float64, requires_grad=True)
    (found,) = torch.autograd.grad(value(y).sum(), y)
    with torch.no_grad():
        wanted = (value(y + 1e-5) - value(y - 1e-5)) / 2e-5
    moved = (ours.object_state[:, 4:6] - torch.tensor([0.05, 0.03])).norm(dim=1)
    assert float(moved.min()) > 5e-3
    np.testing.assert_allclose(found.numpy(), wanted.numpy(), rtol=1e-3)


def test_a_world_that_begins_anew_has_no_gradient_and_the_others_keep_theirs(training):
    ours = PushWorlds(training, W, 0)
    action = torch.zeros(W, 2, requires_grad=True)
    ours.advance(action)
    anew = torch.arange(W) < 2
    ours.begin(anew)
    (bar,) = torch.autograd.grad(ours.p_WP[:, 0].sum(), action)
    np.testing.assert_allclose(bar[:, 0].numpy(), np.where(anew, 0.0, training.options.max_translation))


def test_cousins_are_refused():
    training = TrainingWorlds("push_t", training_options(), num_worlds=W)
    with pytest.raises(ParameterError, match="cousins"):
        PushWorlds(training, W, 0)
