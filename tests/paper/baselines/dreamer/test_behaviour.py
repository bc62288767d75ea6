# SPDX-License-Identifier: MIT
"""Actor and critic."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.stats import kstest, truncnorm

from pinwm_drake.paper.baselines.dreamer import behaviour as module
from pinwm_drake.paper.baselines.dreamer.behaviour import Actor, Behaviour, TruncatedNormal, imagine, lambda_returns
from pinwm_drake.paper.baselines.dreamer.episodes import Replay
from pinwm_drake.paper.baselines.dreamer.options import BehaviourOptions
from pinwm_drake.paper.baselines.dreamer.world_model import WorldModel
from tests.paper.baselines.dreamer.small import SIZES, numbered

OPTIONS = BehaviourOptions(horizon=5)


@pytest.fixture
def model():
    torch.manual_seed(0)
    return WorldModel(8, 2, SIZES).requires_grad_(False)


def test_returns_are_those_computed_by_hand():
    reward, value = torch.tensor([[1.0], [2.0], [9.0]]), torch.tensor([[9.0], [10.0], [20.0]])
    discount = torch.tensor([[0.5], [0.8], [9.0]])
    # V_1 = 2 + 0.8 * 20 = 18; V_0 = 1 + 0.5 * (0.25 * 10 + 0.75 * 18) = 9.
    assert lambda_returns(reward, discount, value, 0.75)[:, 0].tolist() == [9.0, 18.0]
    # λ = 0: one step; λ = 1: the whole sequence.
    assert lambda_returns(reward, discount, value, 0.0)[:, 0].tolist() == [6.0, 18.0]
    assert lambda_returns(reward, discount, value, 1.0)[:, 0].tolist() == [10.0, 18.0]


def test_an_imagined_sequence_has_the_shapes_that_are_told(model):
    start = model.perception.rssm.initial(3)
    found = imagine(model, Actor(2, SIZES), start, torch.tensor([False, True, False]), OPTIONS)
    assert found.features.shape == (6, 3, SIZES.feature_size)
    assert found.reward.shape == found.discount.shape == found.weight.shape == (6, 3)
    torch.testing.assert_close(found.features[0], start.features)
    # After the end of an episode nothing counts.
    assert found.discount[0].tolist() == [pytest.approx(0.99), 0.0, pytest.approx(0.99)]
    assert found.weight[0].tolist() == [1.0, 1.0, 1.0]
    assert not found.weight[1:, 1].any()
    torch.testing.assert_close(found.weight[2, 0], found.discount[0, 0] * found.discount[1, 0])


def test_losses_reach_actor_and_critic_and_nothing_else(model):
    behaviour = Behaviour(2, SIZES)
    batch = Replay([numbered(9), numbered(9)]).draw(4, 6, np.random.default_rng(0))
    actor, critic = behaviour.losses(model, batch, OPTIONS)
    actor.backward(retain_graph=True)
    assert all(one.grad is not None and one.grad.any() for one in behaviour.actor.parameters())
    assert all(one.grad is None for one in behaviour.critic.parameters())
    critic.backward()
    assert all(one.grad is not None for one in behaviour.critic.parameters())
    assert all(one.grad is None for one in [*behaviour.slow.parameters(), *model.parameters()])


def test_losses_are_those_computed_from_what_is_imagined(model, monkeypatch):
    behaviour, options = Behaviour(2, SIZES), replace(OPTIONS, entropy=0.3, trace=0.7)
    with torch.no_grad():  # or critic and slow critic are the same
        behaviour.critic[0].bias += 1.0
    batch, seen = Replay([numbered(9), numbered(9)]).draw(4, 6, np.random.default_rng(0)), []

    def kept(*arguments):
        seen.append(imagine(*arguments))
        return seen[-1]

    monkeypatch.setattr(module, "imagine", kept)
    actor, critic = behaviour.losses(model, batch, options)
    (found,) = seen
    H, N = options.horizon, found.reward.shape[1]
    value, slow = (network(found.features)[..., 0] for network in (behaviour.critic, behaviour.slow))
    entropy = behaviour.actor(found.features).entropy()
    gain, error = 0.0, 0.0
    for n in range(N):
        after, returns = slow[H, n], {}
        for t in reversed(range(H)):
            after = found.reward[t, n] + found.discount[t, n] * (0.3 * slow[t + 1, n] + 0.7 * after)
            returns[t] = after
        weight = 1.0
        for t in range(H):
            error = error + 0.5 * weight * (value[t, n] - returns[t]) ** 2
            if t < H - 1:  # what the action of step t led to
                gain = gain + weight * (returns[t + 1] + 0.3 * entropy[t, n])
            weight = weight * found.discount[t, n]
    torch.testing.assert_close(critic, error / (H * N))
    torch.testing.assert_close(actor, -gain / ((H - 1) * N))


def test_the_slow_critic_follows_when_told():
    behaviour = Behaviour(2, SIZES)
    with torch.no_grad():
        behaviour.critic[0].bias += 1.0
    assert not torch.equal(behaviour.slow[0].bias, behaviour.critic[0].bias)
    behaviour.follow()
    assert torch.equal(behaviour.slow[0].bias, behaviour.critic[0].bias)


def test_the_gradient_through_the_dynamics_leads_to_more_reward(model):
    """The reward is one component of the recurrent state, which the actions can move."""
    rssm = model.perception.rssm
    for one in [*model.reward.parameters(), *model.goes_on.parameters()]:
        one.zero_()
    model.goes_on[-1].bias.fill_(20.0)
    model.reward[0].weight[0, -1] = 5.0
    model.reward[-1].weight[0, 0] = 1.0
    rssm.inward[0].weight[:, -2:] *= 10.0
    actor_critic = Behaviour(2, SIZES)
    optimizer = torch.optim.Adam(actor_critic.actor.parameters(), 3e-3)
    replay, returns = Replay([numbered(9), numbered(9)]), []
    for number in range(80):
        loss, _ = actor_critic.losses(model, replay.draw(8, 4, np.random.default_rng(number)), OPTIONS)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        returns.append(-loss.item())
    assert np.mean(returns[-10:]) > np.mean(returns[:10]) + 0.5


CASES = [(0.0, 1.0), (0.9, 0.1), (-1.0, 0.3), (0.3, 2.0)]


def oracle(mean, std):
    return truncnorm((-1.0 - mean) / std, (1.0 - mean) / std, mean, std)


@pytest.mark.parametrize(("mean", "std"), CASES)
def test_entropy_and_samples_are_those_of_scipy(mean, std):
    torch.manual_seed(0)
    one = TruncatedNormal(torch.full((4000, 1), mean), torch.full((4000, 1), std))
    np.testing.assert_allclose(one.entropy().numpy(), oracle(mean, std).entropy(), atol=1e-5)  # of float32
    assert kstest(one.rsample().numpy()[:, 0], oracle(mean, std).cdf).pvalue > 1e-3


def test_components_add_up():
    mean, std = torch.tensor([[0.2, -0.5]]), torch.tensor([[0.4, 1.5]])
    expected = oracle(0.2, 0.4).entropy() + oracle(-0.5, 1.5).entropy()
    assert TruncatedNormal(mean, std).entropy().item() == pytest.approx(expected, abs=1e-5)


def test_gradients_of_samples_are_finite_differences():
    def sample(mean, std):
        torch.manual_seed(3)
        return TruncatedNormal(mean, std).rsample()

    mean, std = (torch.tensor([[a, b]], dtype=torch.float64, requires_grad=True) for a, b in [(0.2, -0.6), (0.3, 0.8)])
    assert torch.autograd.gradcheck(sample, (mean, std))


def test_samples_stay_inside_where_the_mean_is_at_the_border():
    torch.manual_seed(0)
    found = TruncatedNormal(torch.ones(10_000, 1), torch.full((10_000, 1), 0.1)).rsample()
    assert found.abs().max() < 1.0
    assert torch.isfinite(found).all()


@pytest.mark.parametrize("border", [-1.0, 1.0])
@pytest.mark.parametrize("drawn", [0.0, 1.0 - 2.0**-24])
def test_the_least_and_the_largest_draw_are_inside_too(monkeypatch, border, drawn):
    monkeypatch.setattr(torch, "rand_like", lambda x: torch.full_like(x, drawn))
    mean = torch.full((1, 1), border, requires_grad=True)
    found = TruncatedNormal(mean, torch.full((1, 1), 0.1)).rsample()
    found.sum().backward()
    assert found.abs().max() < 1.0
    assert torch.isfinite(mean.grad).all()
