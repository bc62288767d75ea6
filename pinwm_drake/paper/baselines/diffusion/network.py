# SPDX-License-Identifier: MIT
"""Network of diffusion policy: encoder of images and temporal U-Net, their loss, and how they draw actions.

Sources: Ho et al., "Denoising diffusion probabilistic models" (NeurIPS 2020); Nichol and Dhariwal, "Improved denoising
diffusion probabilistic models" (ICML 2021) for the squared cosine; Song et al., "Denoising diffusion implicit models"
(ICLR 2021); Chi et al., "Diffusion policy" (RSS 2023).
"""

import math
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn.functional import mse_loss

from pinwm_drake.errors import require_package
from pinwm_drake.paper.baselines.diffusion.options import NORM_CHANNELS, NetworkOptions


class ImageEncoder(nn.Module):
    """Network from an image to features; every stage halves the image.

    Source: Chi et al., "Diffusion policy" (RSS 2023), section III.A; the stages are fewer than those of a ResNet-18.
    """

    def __init__(self, options: NetworkOptions) -> None:
        super().__init__()
        first, *rest = options.channels
        stages: list[nn.Module] = [nn.Conv2d(3, first, 5, 2, 2, bias=False), _norm(first), nn.ReLU()]
        before = first
        for channels in rest:
            stages.append(_Stage(before, channels))
            before = channels
        self.stages = nn.Sequential(*stages)
        self.points = nn.Conv2d(before, options.keypoints, 1)
        self.head = nn.Linear(2 * options.keypoints, options.image_features)

    def forward(self, dark: Tensor) -> Tensor:
        """Features (B, image_features) of images (B, 3, height, width) float32, 0 for white and 1 for black."""
        features: Tensor = self.head(spatial_softmax(self.points(self.stages(dark))).flatten(1))
        return features


def spatial_softmax(maps: Tensor) -> Tensor:
    """Mean places (B, K, 2) under the softmax of maps (B, K, height, width): x along the width, then y.

    They are -1 and 1 at the centres of the first and last pixels; a side of one pixel has its place at 0.
    """
    shares = maps.flatten(2).softmax(-1).unflatten(2, maps.shape[2:])
    height, width = (torch.linspace(-1.0, 1.0, size) if size > 1 else torch.zeros(1) for size in maps.shape[2:])
    return torch.stack([shares.sum(2) @ width.to(maps), shares.sum(3) @ height.to(maps)], dim=-1)


class _Stage(nn.Module):
    """Residual block of two convolutions, the first of which halves the image."""

    def __init__(self, before: int, channels: int) -> None:
        super().__init__()
        self.body = nn.Sequential(
            nn.Conv2d(before, channels, 3, 2, 1, bias=False),
            _norm(channels),
            nn.ReLU(),
            nn.Conv2d(channels, channels, 3, 1, 1, bias=False),
            _norm(channels),
        )
        self.short = nn.Sequential(nn.Conv2d(before, channels, 1, 2, bias=False), _norm(channels))

    def forward(self, x: Tensor) -> Tensor:
        return torch.relu(self.body(x) + self.short(x))


def _norm(channels: int) -> nn.GroupNorm:
    return nn.GroupNorm(max(1, channels // NORM_CHANNELS), channels)


class TemporalUnet(nn.Module):
    """U-Net along time, whose levels each halve the sequence but for the last; every block is modulated.

    Attributes:
        step: Network from the diffusion's step to features.
    """

    def __init__(self, options: NetworkOptions, action_size: int, condition_size: int) -> None:
        super().__init__()
        features = options.step_features
        self.step = nn.Sequential(
            _Waves(features), nn.Linear(features, 4 * features), nn.Mish(), nn.Linear(4 * features, features)
        )
        size = features + condition_size

        def pair(before: int, after: int) -> nn.ModuleList:
            return nn.ModuleList([_Block(before, after, size, options), _Block(after, after, size, options)])

        widths = options.widths
        inputs = (action_size, *widths[:-1])
        self.down = nn.ModuleList([pair(before, after) for before, after in zip(inputs, widths, strict=True)])
        self.shorter = nn.ModuleList([nn.Conv1d(width, width, 3, 2, 1) for width in widths[:-1]])
        self.middle = pair(widths[-1], widths[-1])
        upwards = list(zip(widths[:0:-1], widths[-2::-1], strict=True))
        self.up = nn.ModuleList([pair(2 * before, after) for before, after in upwards])
        self.longer = nn.ModuleList([nn.ConvTranspose1d(after, after, 4, 2, 1) for _, after in upwards])
        self.head = nn.Sequential(_convolution(widths[0], widths[0], options), nn.Conv1d(widths[0], action_size, 1))

    def forward(self, noisy: Tensor, step: Tensor, condition: Tensor) -> Tensor:
        """Noise (B, Th, n) in sequences of actions.

        Args:
            noisy: (B, Th, n) normalised actions with noise.
            step: (B,) whole numbers, step of the diffusion: 0 is the least noise.
            condition: (B, C) features of what is seen.
        """
        given = torch.cat([self.step(step), condition], 1)
        x, kept = noisy.transpose(1, 2), []
        for level, blocks in enumerate(self.down):
            x = _through(blocks, x, given)
            kept.append(x)
            x = self.shorter[level](x) if level < len(self.shorter) else x
        x = _through(self.middle, x, given)
        for blocks, longer in zip(self.up, self.longer, strict=True):
            x = longer(_through(blocks, torch.cat([x, kept.pop()], 1), given))
        noise: Tensor = self.head(x).transpose(1, 2)
        return noise


class _Block(nn.Module):
    """Residual block: two convolutions, between which the condition scales and shifts each channel (FiLM)."""

    def __init__(self, before: int, after: int, condition_size: int, options: NetworkOptions) -> None:
        super().__init__()
        self.first, self.second = _convolution(before, after, options), _convolution(after, after, options)
        self.film = nn.Sequential(nn.Mish(), nn.Linear(condition_size, 2 * after))
        self.short = nn.Conv1d(before, after, 1) if before != after else nn.Identity()

    def forward(self, x: Tensor, given: Tensor) -> Tensor:
        scale, shift = self.film(given).unsqueeze(-1).chunk(2, 1)
        found: Tensor = self.second(scale * self.first(x) + shift) + self.short(x)
        return found


class _Waves(nn.Module):
    """Sines and cosines (B, features) of a step, with wavelengths from 2 pi to 20,000 pi.

    Source: Vaswani et al., "Attention is all you need" (NeurIPS 2017), section 3.5.
    """

    def __init__(self, features: int) -> None:
        super().__init__()
        self._half = features // 2

    def forward(self, step: Tensor) -> Tensor:
        rates = torch.exp(-math.log(1e4) / max(self._half - 1, 1) * torch.arange(self._half, device=step.device))
        angles = step[:, None].float() * rates
        return torch.cat([angles.sin(), angles.cos()], 1)


def _convolution(before: int, after: int, options: NetworkOptions) -> nn.Sequential:
    return nn.Sequential(
        nn.Conv1d(before, after, options.kernel, padding=options.kernel // 2),
        nn.GroupNorm(options.groups, after),
        nn.Mish(),
    )


def _through(blocks: nn.Module, x: Tensor, given: Tensor) -> Tensor:
    assert isinstance(blocks, nn.ModuleList)
    for block in blocks:
        x = block(x, given)
    return x


_FLAT = 1e-4  # range of a component, below which it is not stretched
_SCHEDULE = {"beta_schedule": "squaredcos_cap_v2", "clip_sample": True, "prediction_type": "epsilon"}


class Stretch(nn.Module):
    """Stretch of each component of some data to [-1, 1], from its least and largest value.

    Attributes:
        middle: (n,) middle of the values.
        reach: (n,) half of their range; 1 where it is hardly any.
    """

    middle: Tensor
    reach: Tensor

    def __init__(self, size: int) -> None:
        super().__init__()
        self.register_buffer("middle", torch.zeros(size))
        self.register_buffer("reach", torch.ones(size))

    def fit(self, values: Tensor) -> None:
        """Take the range of values (m, n)."""
        low, high = values.amin(0), values.amax(0)
        self.middle.copy_(0.5 * (low + high))
        self.reach.copy_(torch.where(high - low > _FLAT, 0.5 * (high - low), 1.0))

    def forward(self, values: Tensor) -> Tensor:
        """Stretched values (..., n)."""
        return (values - self.middle) / self.reach

    def back(self, stretched: Tensor) -> Tensor:
        """Values (..., n) that were stretched."""
        return self.middle + self.reach * stretched


class DiffusionNetwork(nn.Module):
    """Network that tells the noise in sequences of actions, given the last images and positions of the pusher.

    Attributes:
        options: Settings of the network.
        action: Stretch of the actions.
        pusher: Stretch of the pusher's positions.
    """

    def __init__(self, options: NetworkOptions, action_size: int) -> None:
        super().__init__()
        self.options = options
        self.action, self.pusher = Stretch(action_size), Stretch(action_size)
        self.encoder = ImageEncoder(options)
        self.unet = TemporalUnet(options, action_size, options.observations * (options.image_features + action_size))

    def condition(self, dark: Tensor, pusher: Tensor) -> Tensor:
        """Features (B, C) of what is seen; see `loss`."""
        count = self.options.observations
        features = self.encoder(dark.unflatten(1, (count, 3)).flatten(0, 1)).unflatten(0, (-1, count))
        return torch.cat([features, self.pusher(pusher)], 2).flatten(1)

    def loss(self, dark: Tensor, pusher: Tensor, action: Tensor) -> Tensor:
        """Mean squared error () of the noise, at steps of the diffusion that torch's generator draws.

        Args:
            dark: (B, 3 To, height, width) float32, 0 for white and 1 for black: the last images, the oldest first.
            pusher: (B, To, n) float32, along the task's axes across the pusher's box, -1 to 1.
            action: (B, Th, n) float32, in [-1, 1].
        """
        scheduler = _schedulers().DDPMScheduler(self.options.diffusion_steps, **_SCHEDULE)
        clean = self.action(action)
        # Drawn on the CPU, whose generator a checkpoint keeps.
        noise = torch.randn(clean.shape).to(clean)
        step = torch.randint(self.options.diffusion_steps, (len(clean),)).to(clean.device)
        noisy = scheduler.add_noise(clean, noise, step)
        return mse_loss(self.unet(noisy, step, self.condition(dark, pusher)), noise)

    @torch.no_grad()
    def sample(self, dark: Tensor, pusher: Tensor, noise: Tensor) -> Tensor:
        """Actions (B, Th, n) that DDIM makes of noise (B, Th, n); what is seen is as for `loss`."""
        scheduler = _schedulers().DDIMScheduler(self.options.diffusion_steps, **_SCHEDULE)
        scheduler.set_timesteps(self.options.sampling_steps)
        condition, found = self.condition(dark, pusher), noise
        for step in scheduler.timesteps:
            steps = torch.full((len(found),), int(step), device=found.device)
            found = scheduler.step(self.unet(found, steps, condition), step, found).prev_sample
        return self.action.back(found)


def require_diffusers() -> None:
    """Check that diffusers is installed, which has the schedules of the noise.

    Raises:
        ParameterError: It is not.
    """
    require_package("diffusers", "paper", "diffusion policy")


def _schedulers() -> Any:
    require_diffusers()
    import diffusers

    return diffusers
