# SPDX-License-Identifier: MIT
import numpy as np
import torch

from pinwm_drake.learning.actors import DitherActor
from pinwm_drake.learning.policy import make_actor
from pinwm_drake.tasks.push import PushTask
from tests.learning.toy_worlds import toy_spec


def between_two_ways(spread):
    """Actor whose mean is 0 in every state, with the same spread in all."""
    actor = DitherActor(PushTask(), 16)
    with torch.no_grad():
        actor.head.weight.zero_()
        actor.head.bias.copy_(torch.tensor([0.0, np.log(spread)] * 2))
    return actor


def states(number):
    return torch.from_numpy(np.random.default_rng(0).uniform(-1.0, 1.0, (number, 11)).astype(np.float32))


def test_its_actions_are_as_far_from_the_mean_as_draws_are():
    with torch.no_grad():
        off = torch.atanh(between_two_ways(0.2)(states(4000))).numpy()
    # A wave of amplitude sqrt(2): standard deviation 1.
    np.testing.assert_allclose(off.std(axis=0), 0.2, rtol=0.03)
    assert np.abs(off).max() <= 0.2 * np.sqrt(2.0) + 1e-5
    assert abs(np.corrcoef(off.T)[0, 1]) < 0.1


def test_it_leaves_a_state_in_which_its_mean_stands_still():
    actor, state = between_two_ways(0.1), states(1)
    start = state[:, 9:11].clone()
    way = []
    with torch.no_grad():
        for _ in range(30):
            action = actor(state)
            state[:, 9:11] += 0.2 * action  # the pusher alone moves, by up to 20 mm
            way.append(float((state[:, 9:11] - start).norm()))
    assert max(way) > 0.03
    assert min(np.diff([0.0, *way]), key=abs) != 0.0


def test_it_is_learned_from_by_its_mean_alone():
    actor, seen = between_two_ways(0.2), states(8)
    assert float(actor.imitation(seen, seen)) == 0.0
    found = seen.clone().requires_grad_(True)
    actor.imitation(found, seen + 0.5).backward()
    assert float(found.grad.abs().max()) == 0.0  # a mean that does not depend on the state
    assert torch.isinf(actor.margin(seen)).all()


def test_states_before_are_estimated_and_the_rest_of_a_history_is_known():
    actor, pusher = make_actor(toy_spec("rgb", frames=3, history=2)), torch.rand(5, 10) - 0.5
    with torch.no_grad():
        found = actor.state(255 * torch.rand(5, 16, 16, 9), pusher)
    now, first, first_action, second, second_action = found.split([11, 11, 2, 11, 2], 1)
    for state, at in ((now, 0), (first, 2), (second, 6)):
        p_WP = torch.tensor([0.0, 0.1]) + 0.3 * pusher[:, at : at + 2]
        np.testing.assert_allclose(state[:, 9:], p_WP / 0.1, atol=1e-5)
    np.testing.assert_array_equal(torch.cat([first_action, second_action], 1), pusher[:, [4, 5, 8, 9]])
    for one, other in ((now, first), (first, second)):  # estimates of their own
        assert (one - other)[:, :7].abs().max() > 1e-4


def test_a_wave_is_one_of_the_state_of_now():
    actor = DitherActor(PushTask(), 16, history=1)
    with torch.no_grad():
        actor.head.weight.zero_()
        seen = torch.cat([states(8), torch.rand(8, 13)], 1)
        found = actor(seen)
        seen[:, 11:] = 0.0
        np.testing.assert_array_equal(actor(seen), found)
    assert found.abs().max() > 0.1


def test_numbers_of_16_bits_change_estimates_and_gradients_by_rounding_alone():
    torch.manual_seed(0)
    actor = make_actor(toy_spec("rgb", frames=3))
    image, pusher = 255 * torch.rand(64, 16, 16, 9), torch.rand(64, 2) - 0.5
    found = {}
    for mixed in (False, True):
        actor.mixed_precision = mixed
        state = actor.state(image, pusher)
        actor.zero_grad()
        state.square().mean().backward()
        found[mixed] = state.detach(), torch.cat([one.grad.flatten() for one in actor.convolutions.parameters()])
    for exact, rounded in zip(found[False], found[True], strict=True):
        assert rounded.dtype == torch.float32
        error = float((rounded - exact).norm() / exact.norm())
        assert 0.0 < error < 0.02
    assert all(one.dtype == torch.float32 for one in actor.parameters())
