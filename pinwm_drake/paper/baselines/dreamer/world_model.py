# SPDX-License-Identifier: MIT
"""World model of images, the pusher's position, rewards and ends of episodes, with recurrent categorical latents.

Source: Hafner et al., "Mastering Atari with discrete world models" (ICLR 2021), equations 1 to 5; the cell as in the
paper's code.
"""

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.distributions import OneHotCategoricalStraightThrough
from torch.nn.functional import binary_cross_entropy_with_logits

from pinwm_drake.errors import ParameterError
from pinwm_drake.learning.actors import ImageActor
from pinwm_drake.learning.weights import device_of
from pinwm_drake.paper.baselines.dreamer.episodes import Batch
from pinwm_drake.paper.baselines.dreamer.options import ModelOptions, NetworkOptions

_LAST = 4  # px, side of the encoder's last feature maps
_SMALLEST = 8  # px, side of the smallest images


def layers(inputs: int, units: int, number: int, outputs: int) -> nn.Sequential:
    """Hidden layers of one width with ELU, and a linear layer to the outputs."""
    widths = [inputs, *[units] * number]
    hidden = [part for a, b in pairwise(widths) for part in (nn.Linear(a, b), nn.ELU())]
    return nn.Sequential(*hidden, nn.Linear(widths[-1], outputs))


def halvings(size: int) -> int:
    """Return the number of convolutions that take images of a size [px] to the last feature maps.

    Raises:
        ParameterError: The size is no power of two, or less than 8.
    """
    if size < _SMALLEST or size & (size - 1):
        raise ParameterError(f"image size: got {size}; allowed: a power of two, {_SMALLEST} px or more")
    return int(math.log2(size // _LAST))


class Encoder(nn.Module):
    """Network from an image and the pusher's position to features.

    Each convolution halves the images exactly, by padding. The official ones have none, and fit 64 px alone.

    Attributes:
        size: Number of features.
    """

    def __init__(self, image_size: int, pusher_size: int, depth: int, units: int) -> None:
        super().__init__()
        channels = [3, *(depth * 2**k for k in range(halvings(image_size)))]
        self.convolutions = nn.Sequential(
            *(part for a, b in pairwise(channels) for part in (nn.Conv2d(a, b, 4, 2, 1), nn.ELU())),
            nn.Flatten(),
        )
        self.pusher = nn.Sequential(layers(pusher_size, units, 1, units), nn.ELU())
        self.size = _LAST**2 * channels[-1] + units

    def forward(self, dark: Tensor, pusher: Tensor) -> Tensor:
        """Features (N, size) of images (N, 3, size, size) float32, 0 for white, and pushers (N, n) in [-1, 1]."""
        return torch.cat([self.convolutions(dark), self.pusher(pusher)], 1)


class Decoder(nn.Module):
    """Network from features of a latent state to the means of image and pusher's position."""

    def __init__(self, features: int, image_size: int, pusher_size: int, depth: int, units: int) -> None:
        super().__init__()
        channels = [*(depth * 2**k for k in reversed(range(halvings(image_size)))), 3]
        first = channels[0]
        self.first = nn.Sequential(nn.Linear(features, first * _LAST**2), nn.Unflatten(1, (first, _LAST, _LAST)))
        parts: list[nn.Module] = []
        for a, b in pairwise(channels):
            parts += [nn.ConvTranspose2d(a, b, 4, 2, 1), nn.ELU()]
        self.convolutions = nn.Sequential(*parts[:-1])
        self.pusher = layers(features, units, 1, pusher_size)

    def forward(self, features: Tensor) -> tuple[Tensor, Tensor]:
        """Images (N, 3, size, size), 0 for white, and pushers (N, n), of features (N, features)."""
        return self.convolutions(self.first(features)), self.pusher(features)


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
        """Latent states (B, L, ...) of sequences, and the posterior's logits (B, L, latents, classes)."""
        latent, states, logits = self.initial(len(action)), [], []
        for t in range(action.shape[1]):
            latent, found = self.see(latent, action[:, t], embed[:, t], first[:, t], mode=mode)
            states.append(latent)
            logits.append(found)
        return Latent(*(torch.stack(parts, 1) for parts in zip(*states, strict=True))), torch.stack(logits, 1)


class Perception(nn.Module):
    """Part of the world model that a policy needs: the encoder, and the latent dynamics.

    Raises:
        ParameterError: The side of the images [px] is no power of two, or less than 8.
    """

    def __init__(self, image_size: int, action_size: int, sizes: NetworkOptions) -> None:
        super().__init__()
        self.encoder = Encoder(image_size, action_size, sizes.depth, sizes.units)
        self.rssm = Rssm(action_size, self.encoder.size, sizes)

    def embed(self, image: Tensor, pusher: Tensor) -> Tensor:
        """Features (..., size) of images (..., height, width, 3) uint8 RGB and pushers (..., n)."""
        lead = image.shape[:-3]
        return self.encoder(ImageActor.darken(image.flatten(0, -4)), pusher.flatten(0, -2)).unflatten(0, lead)


@dataclass(frozen=True, eq=False)
class Terms:
    """Terms of the world model's loss, each () and weighted as in the sum.

    Attributes:
        image: Half the squared error of the images, summed over pixels.
        end: Cross-entropy of the end of episodes.
        divergence: Balanced divergence of posterior and prior.
        nats: The divergence itself [nat], without a gradient.
    """

    image: Tensor
    pusher: Tensor
    reward: Tensor
    end: Tensor
    divergence: Tensor
    nats: Tensor

    @property
    def total(self) -> Tensor:
        """The sum that is minimised."""
        return self.image + self.pusher + self.reward + self.end + self.divergence


class WorldModel(nn.Module):
    """Latent dynamics with an encoder, and heads for what is predicted.

    Attributes:
        reward: Head of the reward, in standard deviations of the data's.
        goes_on: Head of the logit that an episode goes on after a step.
    """

    def __init__(self, image_size: int, action_size: int, sizes: NetworkOptions) -> None:
        super().__init__()
        features = sizes.feature_size
        self.perception = Perception(image_size, action_size, sizes)
        self.decoder = Decoder(features, image_size, action_size, sizes.depth, sizes.units)
        self.reward = layers(features, sizes.units, sizes.layers, 1)
        self.goes_on = layers(features, sizes.units, sizes.layers, 1)

    def posterior(self, batch: Batch, *, mode: bool = False) -> tuple[Latent, Tensor]:
        """Latent states (B, L, ...) of sequences, and the posterior's logits; see `Rssm.observe`."""
        embed = self.perception.embed(batch.image, batch.pusher)
        return self.perception.rssm.observe(batch.action, embed, batch.first, mode=mode)

    def loss(self, batch: Batch, options: ModelOptions) -> Terms:
        """Terms of the loss on sequences, means over their steps.

        The reward of a sequence's first step is left out, as the step before is not seen.
        """
        latent, posterior = self.posterior(batch)
        prior = self.perception.rssm.prior_logits(latent.deter)
        features = latent.features.flatten(0, 1)
        image, pusher = self.decoder(features)
        seen = ImageActor.darken(batch.image.flatten(0, 1))
        first, length = batch.first.flatten(), len(features)
        reward = (self.reward(features)[:, 0] - batch.reward.flatten()).masked_fill(first, 0.0)
        going = (~batch.terminal).flatten().to(features.dtype)
        balanced = balanced_divergence(posterior, prior, options.kl_balance, options.free_nats)
        return Terms(
            image=0.5 * (image - seen).square().sum() / length,
            pusher=0.5 * ((pusher - batch.pusher.flatten(0, 1)) / options.pusher_std).square().sum() / length,
            reward=0.5 * (reward / options.reward_std).square().sum() / length,
            end=binary_cross_entropy_with_logits(self.goes_on(features)[:, 0], going),
            divergence=options.kl_scale * balanced,
            nats=divergence(posterior.detach(), prior.detach()).mean(),
        )

    @torch.no_grad()
    def foresee(self, batch: Batch, seen: int, *, mode: bool = False) -> tuple[Tensor, Tensor]:
        """Images (B, L - seen, 3, height, width), 0 for white, and rewards (B, L - seen), of actions alone.

        Args:
            batch: Sequences; what is observed after the first steps is not looked at.
            seen: Number of steps at the beginning whose observations are seen, 1 to L - 1.
            mode: Flag: the likeliest latents instead of drawn ones.
        """
        known = Batch(*(part[:, :seen] for part in batch))
        latent = Latent(*(part[:, -1] for part in self.posterior(known, mode=mode)[0]))
        images, rewards = [], []
        for action in batch.action[:, seen:].unbind(1):
            latent = self.perception.rssm.imagine(latent, action, mode=mode)
            images.append(self.decoder(latent.features)[0])
            rewards.append(self.reward(latent.features)[:, 0])
        return torch.stack(images, 1), torch.stack(rewards, 1)
