"""Encoder of images: residual blocks with group normalisation, and spatial softmax, which tells where things are.

Sources: He et al., "Deep residual learning for image recognition" (CVPR 2016); Wu and He, "Group normalization" (ECCV
2018), as moving averages of weights do not go with batch normalisation; Levine et al., "End-to-end training of deep
visuomotor policies" (JMLR 2016) for spatial softmax.
"""

import torch
from torch import Tensor, nn

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
            stages.append(_Block(before, channels))
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


class _Block(nn.Module):
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
