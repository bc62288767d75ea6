"""Temporal U-Net: noise in a sequence of actions, given the diffusion's step and a condition, by way of FiLM.

Sources: Chi et al., "Diffusion policy" (RSS 2023), section III.A and appendix; Janner et al., "Planning with diffusion
for flexible behavior synthesis" (ICML 2022) for the U-Net along time; Perez et al., "FiLM: visual reasoning with a
general conditioning layer" (AAAI 2018).
"""

import math

import torch
from torch import Tensor, nn

from pinwm_drake.paper.baselines.diffusion.options import NetworkOptions


class TemporalUnet(nn.Module):
    """U-Net along time, whose levels each halve the sequence but for the last; every block is modulated.

    Attributes:
        step: Network from the diffusion's step to features.
    """

    def __init__(self, options: NetworkOptions, action_size: int, condition_size: int) -> None:
        """Makes the layers.

        Args:
            options: Settings of the network.
            action_size: Number of an action's components, n.
            condition_size: Number of the condition's features, C.
        """
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
