"""Targets of the critic against closed forms, and an update in a few worlds."""

import dataclasses

import numpy as np
import pytest
import torch

from benchmarks.short_horizon.learner import Learner, LearnerOptions, td_lambda
from benchmarks.short_horizon.networks import teacher_spec
from benchmarks.short_horizon.worlds import PushWorlds
from pinwm_drake.cousins.domain import CousinDomains
from pinwm_drake.errors import ParameterError
from pinwm_drake.systems.envs.training_worlds import TrainingWorlds, training_options

W, H = 4, 3


@pytest.fixture(scope="module")
def training():
    return TrainingWorlds("push_t", training_options(), num_worlds=W, domains=CousinDomains(delta=0.0))


def learner(training, **changes):
    torch.manual_seed(0)
    options = dataclasses.replace(LearnerOptions(horizon=H, passes=1), **changes)
    return Learner(PushWorlds(training, W, 0), teacher_spec(training), options)


def test_targets_are_sums_to_the_end_and_single_steps_at_the_extremes_of_lambda():
    g = torch.Generator().manual_seed(1)
    rewards, values = torch.randn(2, 4, 2, generator=g, dtype=torch.float64)
    ended = torch.zeros(4, 2, dtype=torch.bool)
    ended[1, 0] = True  # the first world's episode ends after its second action
    single = td_lambda(rewards, values, ended, gamma=0.9, lam=0.0)
    np.testing.assert_allclose(single.numpy(), (rewards + 0.9 * values).numpy(), rtol=1e-6)
    long = td_lambda(rewards, values, ended, gamma=0.9, lam=1.0)
    r, v = rewards.numpy(), values.numpy()
    np.testing.assert_allclose(long[0, 0], r[0, 0] + 0.9 * r[1, 0] + 0.81 * v[1, 0], rtol=1e-6)
    np.testing.assert_allclose(long[0, 1], 0.9 ** np.arange(4) @ r[:, 1] + 0.9**4 * v[3, 1], rtol=1e-6)


def test_both_gradients_of_one_action_agree_in_expectation(training):
    ours, weights = learner(training, critic_first=3), []
    start = ours.worlds.object_state.numpy(), ours.worlds.p_WP.numpy()
    rows = {"through": [], "likelihood": []}
    for _ in range(100):
        ours.worlds.place(*start)
        found = ours.rollout(1)
        weights = [ours.actor.head.bias]
        for name, kept in rows.items():
            kept.append(torch.autograd.grad(getattr(found, name), weights, retain_graph=name == "through")[0])
    through, likelihood = (torch.stack(kept).numpy() for kept in rows.values())
    error = likelihood.std(0) / np.sqrt(len(likelihood))
    assert (np.abs(through.mean(0) - likelihood.mean(0)) < 4.0 * error).all()
    assert through.std(0).max() < 0.5 * likelihood.std(0).max()


@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
def test_an_update_changes_actor_and_critic(training, share):
    ours = learner(training, share=share, arrival=share == 0.5)
    before = [one.detach().clone() for one in (*ours.actor.parameters(), *ours.critic.parameters())]
    told = ours.update(1.0)
    after = [*ours.actor.parameters(), *ours.critic.parameters()]
    assert all(np.isfinite(list(told.values())))
    assert ours.steps == W * H
    assert ours.skipped == 0
    assert not any(torch.equal(old, new) for old, new in zip(before, after, strict=True) if old.numel() > 2)


def test_options_out_of_range_are_refused():
    with pytest.raises(ParameterError, match="gamma"):
        LearnerOptions(gamma=0.0)
    with pytest.raises(ParameterError, match="share"):
        LearnerOptions(share=1.5)
