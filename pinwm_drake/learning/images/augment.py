"""Random changes of images that leave what they show as it is, so that a network does not count on exact pixels."""

import torch
from torch import Tensor

_GROUPS = 8  # parts of a batch, each of which is moved alike: one image at a time takes longer than the network


class Augment:
    """Moves images and changes their colours at random; the background stays white.

    Source: the shift is that of Yarats, Kostrikov and Fergus, "Image augmentation is all you need" (ICLR 2021).
    """

    def __init__(self, shift: int, gain: float) -> None:
        """Keeps the ranges of the changes.

        Args:
            shift: px, largest shift along both axes.
            gain: Relative half-width of a factor for each of red, green and blue, alike in all frames of a stack.
        """
        self._shift, self._gain = shift, gain

    def __call__(self, image: Tensor) -> Tensor:
        """Changed images (B, 3 k, height, width) float32, 0 for white and 1 for black; torch's generator draws.

        Args:
            image: (B, height, width, 3 k) uint8, RGB.
        """
        factors = 1.0 + self._gain * (2.0 * torch.rand(len(image), 3) - 1.0)
        # Moved as bytes, a quarter of what floats are.
        dark = 255 - image
        if self._shift > 0:
            dark = torch.cat([self._moved(group) for group in dark.chunk(_GROUPS)])
        scale = (factors / 255.0).repeat(1, image.shape[3] // 3)
        return dark.permute(0, 3, 1, 2).float().mul_(scale[:, :, None, None].to(image.device))

    def as_images(self, image: Tensor) -> Tensor:
        """Changed images (B, height, width, 3 k) uint8, 255 for white; the argument is that of a call."""
        return (255.0 * (1.0 - self(image))).round_().clamp_(0.0, 255.0).byte().permute(0, 2, 3, 1)

    def _moved(self, dark: Tensor) -> Tensor:
        """Images (b, height, width, 3 k), all moved by the same pixels; 0 comes in from the sides."""
        s = self._shift
        x, y = torch.randint(2 * s + 1, (2,)).tolist()
        height, width = dark.shape[1:3]
        padded = torch.nn.functional.pad(dark, (0, 0, s, s, s, s))
        return padded[:, y : y + height, x : x + width]
