import numpy as np
import torch

from pinwm_drake.learning.actors import DitherActor
from pinwm_drake.tasks import PushTask


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
