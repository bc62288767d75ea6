"""Random changes of images that leave what they show as it is, so that a network does not count on exact pixels."""

import torch
from torch import Tensor

_GROUPS = 8  # of a batch, each of which is moved alike: one image at a time takes longer than the network


class Augment:
    """Moves images and changes their colours at random; the background stays white.

    Source: the shift is that of Yarats, Kostrikov and Fergus, "Image augmentation is all you need" (ICLR 2021).
    """

    def __init__(self, shift: int, gain: float) -> None:
        """Keeps the ranges.

        Args:
            shift: px, at most, along both axes.
            gain: Relative half-width of a factor for each of red, green and blue, alike in all frames of a stack.
        """
        self._shift, self._gain = shift, gain

    def __call__(self, dark: Tensor) -> Tensor:
        """Changed images (B, 3 k, height, width), 0 for white; torch's generator draws."""
        if self._gain > 0.0:
            factors = 1.0 + self._gain * (2.0 * torch.rand(len(dark), 3) - 1.0)
            dark = dark * factors.repeat(1, dark.shape[1] // 3)[:, :, None, None]
        if self._shift > 0:
            dark = torch.cat([self._moved(group) for group in dark.chunk(_GROUPS)])
        return dark

    def _moved(self, dark: Tensor) -> Tensor:
        """All by the same pixels."""
        s = self._shift
        x, y = torch.randint(2 * s + 1, (2,)).tolist()
        padded = torch.nn.functional.pad(dark, (s, s, s, s))
        height, width = dark.shape[2:]
        return padded[:, :, y : y + height, x : x + width]
