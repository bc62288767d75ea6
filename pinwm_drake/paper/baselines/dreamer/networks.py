"""Feed-forward networks of Dreamer V2: layers of heads, and the encoder and decoder of images and the pusher."""

import math
from itertools import pairwise

import torch
from torch import Tensor, nn

from pinwm_drake.errors import ParameterError

_LAST = 4  # px, side of the encoder's last feature maps
_SMALLEST = 8  # px, side of the smallest images


def layers(inputs: int, units: int, number: int, outputs: int) -> nn.Sequential:
    """Hidden layers of one width with ELU, and a linear layer to the outputs."""
    widths = [inputs, *[units] * number]
    hidden = [part for a, b in pairwise(widths) for part in (nn.Linear(a, b), nn.ELU())]
    return nn.Sequential(*hidden, nn.Linear(widths[-1], outputs))


def halvings(size: int) -> int:
    """Number of convolutions that take images of a size [px] to the last feature maps.

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
        """Makes the layers.

        Args:
            image_size: px, side of the images.
            pusher_size: Number n of components of the pusher's position.
            depth: Number of channels of the first convolution.
            units: Width of the layers of the pusher's position.
        """
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
        """Makes the layers; the arguments are those of `Encoder`, and the number of features."""
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
