"""Recurrent state-space model with categorical latents.

Source: Hafner et al., "Mastering Atari with discrete world models" (ICLR 2021), equations 1, 4 and 5; the cell as in
the paper's code.
"""

from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.distributions import OneHotCategoricalStraightThrough

from pinwm_drake.learning.weights import device_of
from pinwm_drake.paper.baselines.dreamer.networks import layers
from pinwm_drake.paper.baselines.dreamer.options import NetworkOptions

_UPDATE_BIAS = -1.0  # of the cell, so that it begins by remembering


class Latent(NamedTuple):
    """Latent state of B sequences; further axes may lead.

    Attributes:
        deter: (B, deter) recurrent state.
        stoch: (B, latents, classes) one-hot latents, drawn; their gradient is that of the probabilities.
    """

    deter: Tensor
    stoch: Tensor

    @property
    def features(self) -> Tensor:
        """Features (B, latents * classes + deter) that the heads, actor and critic see."""
        return torch.cat([self.stoch.flatten(-2), self.deter], -1)


def draw(logits: Tensor, *, mode: bool = False) -> Tensor:
    """One-hot latents (..., classes) of logits, drawn by torch's generator, with straight-through gradients.

    Args:
        logits: (..., classes) logits.
        mode: Flag: the likeliest class instead of a drawn one, without a gradient.
    """
    if mode:
        return nn.functional.one_hot(logits.argmax(-1), logits.shape[-1]).to(logits.dtype)
    drawn: Tensor = OneHotCategoricalStraightThrough(logits=logits, validate_args=False).rsample()
    return drawn


def divergence(left: Tensor, right: Tensor) -> Tensor:
    """Kullback-Leibler divergence (...) [nat] of all latents together, of logits (..., latents, classes)."""
    a, b = left.log_softmax(-1), right.log_softmax(-1)
    return (a.exp() * (a - b)).sum((-2, -1))


def balanced_divergence(posterior: Tensor, prior: Tensor, balance: float, free_nats: float) -> Tensor:
    """Loss () of the divergence of the posterior from the prior, whose gradients are weighted apart.

    Source: Hafner et al. (ICLR 2021), algorithm 2; the free nats hold for the mean, as in the paper's code.

    Args:
        posterior: (..., latents, classes) logits.
        prior: (..., latents, classes) logits.
        balance: Weight of the gradient to the prior, 0 to 1; that to the posterior has the rest.
        free_nats: Least value of both terms [nat].
    """
    to_prior = divergence(posterior.detach(), prior).mean().clamp(min=free_nats)
    to_posterior = divergence(posterior, prior.detach()).mean().clamp(min=free_nats)
    return balance * to_prior + (1.0 - balance) * to_posterior


class Cell(nn.Module):
    """Gated recurrent unit whose gates are normalised together."""

    def __init__(self, inputs: int, size: int) -> None:
        super().__init__()
        self.gates = nn.Linear(inputs + size, 3 * size)
        self.norm = nn.LayerNorm(3 * size, eps=1e-3)

    def forward(self, inputs: Tensor, state: Tensor) -> Tensor:
        """Next state (B, size) of inputs (B, inputs) and state (B, size)."""
        reset, candidate, update = self.norm(self.gates(torch.cat([inputs, state], -1))).chunk(3, -1)
        candidate = (reset.sigmoid() * candidate).tanh()
        return torch.lerp(state, candidate, (update + _UPDATE_BIAS).sigmoid())


class Rssm(nn.Module):
    """Latent dynamics: a recurrent state, a prior of the latents from it, and a posterior that sees an observation."""

    def __init__(self, action_size: int, embed_size: int, sizes: NetworkOptions) -> None:
        """Makes the layers.

        Args:
            action_size: Components of an action, n.
            embed_size: Number of the encoder's features.
            sizes: Sizes of the networks.
        """
        super().__init__()
        self._deter, self._shape = sizes.deter, (sizes.latents, sizes.classes)
        drawn = sizes.latents * sizes.classes
        self.inward = nn.Sequential(nn.Linear(drawn + action_size, sizes.hidden), nn.ELU())
        self.cell = Cell(sizes.hidden, sizes.deter)
        self.prior = layers(sizes.deter, sizes.hidden, 1, drawn)
        self.posterior = layers(sizes.deter + embed_size, sizes.hidden, 1, drawn)

    def initial(self, number: int) -> Latent:
        """Latent states of B sequences before anything was seen: zeros, on the device of the layers."""
        device = device_of(self)
        deter = torch.zeros(number, self._deter, device=device)
        return Latent(deter, torch.zeros(number, *self._shape, device=device))

    def advance(self, latent: Latent, action: Tensor) -> Tensor:
        """Next recurrent state (B, deter) after actions (B, n)."""
        found: Tensor = self.cell(self.inward(torch.cat([latent.stoch.flatten(-2), action], -1)), latent.deter)
        return found

    def prior_logits(self, deter: Tensor) -> Tensor:
        """Logits (..., latents, classes) by recurrent states (..., deter)."""
        return self.prior(deter).unflatten(-1, self._shape)

    def imagine(self, latent: Latent, action: Tensor, *, mode: bool = False) -> Latent:
        """Next latent state after actions (B, n), of which nothing is seen; `mode` is that of `draw`."""
        deter = self.advance(latent, action)
        return Latent(deter, draw(self.prior_logits(deter), mode=mode))

    def see(
        self, latent: Latent, action: Tensor, embed: Tensor, first: Tensor, *, mode: bool = False
    ) -> tuple[Latent, Tensor]:
        """Latent state of an observation, and the logits (B, latents, classes) that it was drawn from.

        Args:
            latent: The state before.
            action: (B, n) actions that led here.
            embed: (B, embed_size) features of the observation.
            first: (B,) bool, true where an episode begins: state and action before are those of nothing.
            mode: Flag: the likeliest latents instead of drawn ones.
        """
        kept = (~first).to(embed.dtype)[:, None]
        latent = Latent(latent.deter * kept, latent.stoch * kept[:, :, None])
        deter = self.advance(latent, action * kept)
        logits = self.posterior(torch.cat([deter, embed], -1)).unflatten(-1, self._shape)
        return Latent(deter, draw(logits, mode=mode)), logits

    def observe(self, action: Tensor, embed: Tensor, first: Tensor, *, mode: bool = False) -> tuple[Latent, Tensor]:
        """Latent states (B, L, ...) of sequences, and the posterior's logits (B, L, latents, classes).

        Args:
            action: (B, L, n) actions that led to each step.
            embed: (B, L, embed_size) features of the observations.
            first: (B, L) bool, true where an episode begins; as if it were in each sequence's first step.
            mode: Flag: the likeliest latents instead of drawn ones.
        """
        latent, states, logits = self.initial(len(action)), [], []
        for t in range(action.shape[1]):
            latent, found = self.see(latent, action[:, t], embed[:, t], first[:, t], mode=mode)
            states.append(latent)
            logits.append(found)
        return Latent(*(torch.stack(parts, 1) for parts in zip(*states, strict=True))), torch.stack(logits, 1)
