# SPDX-License-Identifier: MIT
"""Actor and critic, which learn in sequences that the world model imagines.

Source: Hafner et al., "Mastering Atari with discrete world models" (ICLR 2021), equations 6 to 8; the actor follows the
gradient through the model's dynamics, as in the paper for continuous actions.
"""

import copy
import math
from typing import NamedTuple

import torch
from torch import Tensor, nn

from pinwm_drake.paper.baselines.dreamer.episodes import Batch
from pinwm_drake.paper.baselines.dreamer.options import BehaviourOptions, NetworkOptions
from pinwm_drake.paper.baselines.dreamer.world_model import Latent, WorldModel, layers

_ROOT = math.sqrt(2.0)
_LOG = 0.5 * math.log(2.0 * math.pi * math.e)
_INSIDE = 1.0 - 1e-6  # largest action that is drawn


class TruncatedNormal:
    """Normal distribution of independent components within [-1, 1].

    Attributes:
        mean: (..., n) mean of the whole normal distribution, within [-1, 1]: the mode of the cut one.
        std: (..., n) standard deviation of the whole one.
    """

    def __init__(self, mean: Tensor, std: Tensor) -> None:
        self.mean, self.std = mean, std
        self._low, self._high = (-1.0 - mean) / std, (1.0 - mean) / std
        self._below = _cdf(self._low)
        self._inside = _cdf(self._high) - self._below

    def rsample(self) -> Tensor:
        """Sample (..., n), drawn by torch's generator, with a gradient to mean and standard deviation."""
        share = self._below + torch.rand_like(self.mean) * self._inside
        least = torch.finfo(share.dtype).eps  # a share of 0 or 1, which rounding makes, would be infinitely far
        found = self.mean + self.std * torch.special.ndtri(share.clamp(least, 1.0 - least))
        # Cut off by rounding only, which leaves the gradient as it is.
        return found + (found.clamp(-_INSIDE, _INSIDE) - found).detach()

    def entropy(self) -> Tensor:
        """Entropy (...) [nat] of all components together."""
        low, high = self._low * _density(self._low), self._high * _density(self._high)
        return (_LOG + self.std.log() + self._inside.log() + 0.5 * (low - high) / self._inside).sum(-1)


def _cdf(x: Tensor) -> Tensor:
    return 0.5 * (1.0 + torch.erf(x / _ROOT))


def _density(x: Tensor) -> Tensor:
    return (-0.5 * x * x).exp() / math.sqrt(2.0 * math.pi)


_LEAST_STD = 0.1


class Actor(nn.Module):
    """Network from features of a latent state to a distribution of actions."""

    def __init__(self, action_size: int, sizes: NetworkOptions) -> None:
        super().__init__()
        self.body = layers(sizes.feature_size, sizes.units, sizes.layers, 2 * action_size)

    def forward(self, features: Tensor) -> TruncatedNormal:
        """Distribution of actions (..., n) by features (..., features)."""
        mean, std = self.body(features).chunk(2, -1)
        return TruncatedNormal(mean.tanh(), 2.0 * (0.5 * std).sigmoid() + _LEAST_STD)


def lambda_returns(reward: Tensor, discount: Tensor, value: Tensor, trace: float) -> Tensor:
    """Return V (H, N) of steps 0 to H - 1 of sequences, V_t = r_t + γ_t ((1 - λ) v_{t+1} + λ V_{t+1}), V_H = v_H.

    Source: Hafner et al. (ICLR 2021), equation 7, where the reward stands with the state that it led to, as in the
    paper's code.

    Args:
        reward: (H + 1, N) rewards of reaching each state; the last one is not used.
        discount: (H + 1, N) discounts of what follows each state; the last one is not used.
        value: (H + 1, N) values of each state.
        trace: Weight λ of longer returns, 0 to 1.
    """
    found, after = [], value[-1]
    for t in reversed(range(len(reward) - 1)):
        after = reward[t] + discount[t] * ((1.0 - trace) * value[t + 1] + trace * after)
        found.append(after)
    return torch.stack(found[::-1])


class Imagined(NamedTuple):
    """Sequences of H + 1 states that a policy leads to in a model.

    Attributes:
        features: (H + 1, N, features) features, the first of a state that was seen.
        reward: (H + 1, N) rewards of reaching each.
        discount: (H + 1, N) discounts of what follows each, 0 where the episode is over.
        weight: (H + 1, N) products of the discounts before each, without a gradient.
    """

    features: Tensor
    reward: Tensor
    discount: Tensor
    weight: Tensor


def imagine(model: WorldModel, actor: Actor, start: Latent, terminal: Tensor, options: BehaviourOptions) -> Imagined:
    """Sequences that the actor leads to from N states.

    Args:
        start: States (N, ...).
        terminal: (N,) bool, true where a start is the end of its episode.
    """
    latent, features = start, [start.features]
    for _ in range(options.horizon):
        action = actor(features[-1].detach()).rsample()
        latent = model.perception.rssm.imagine(latent, action)
        features.append(latent.features)
    found = torch.stack(features)
    going = model.goes_on(found[1:])[..., 0].sigmoid()
    discount = options.discount * torch.cat([(~terminal).to(going.dtype)[None], going])
    weight = torch.cat([torch.ones_like(discount[:1]), discount[:-1]]).cumprod(0).detach()
    return Imagined(found, model.reward(found)[..., 0], discount, weight)


class Behaviour(nn.Module):
    """Actor, critic, and the slow copy of the critic that gives the values.

    Attributes:
        critic: Network from features to a value.
        slow: Its copy of some updates ago.
    """

    def __init__(self, action_size: int, sizes: NetworkOptions) -> None:
        super().__init__()
        self.actor = Actor(action_size, sizes)
        self.critic = layers(sizes.feature_size, sizes.units, sizes.layers, 1)
        self.slow = copy.deepcopy(self.critic).requires_grad_(False)

    def follow(self) -> None:
        """Make the slow critic a copy of the critic."""
        self.slow.load_state_dict(self.critic.state_dict())

    def losses(self, model: WorldModel, batch: Batch, options: BehaviourOptions) -> tuple[Tensor, Tensor]:
        """Losses () of actor and critic."""
        with torch.no_grad():
            start = Latent(*(part.flatten(0, 1) for part in model.posterior(batch)[0]))
        seen = imagine(model, self.actor, start, batch.terminal.flatten(), options)
        returns = lambda_returns(seen.reward, seen.discount, self.slow(seen.features)[..., 0], options.trace)
        # The return of the first state does not depend on an action, and the last action leads nowhere.
        entropy = self.actor(seen.features[:-2].detach()).entropy()
        actor = -(seen.weight[:-2] * (returns[1:] + options.entropy * entropy)).mean()
        error = self.critic(seen.features[:-1].detach())[..., 0] - returns.detach()
        critic = 0.5 * (seen.weight[:-1] * error.square()).mean()
        return actor, critic
