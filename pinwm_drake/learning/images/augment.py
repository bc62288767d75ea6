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
        moved, factors = self.drawn(image)
        dark: Tensor = moved.permute(0, 3, 1, 2).to(torch.float32, copy=True).sub_(255.0)
        return dark.mul_((factors / -255.0)[:, :, None, None])

    def drawn(self, image: Tensor) -> tuple[Tensor, Tensor]:
        """Moved images (B, height, width, 3 k) uint8, and factors (B, 3 k) float32 by which they are to be darker.

        Args:
            image: That of a call, which is the two together.
        """
        factors = 1.0 + self._gain * (2.0 * torch.rand(len(image), 3) - 1.0)
        if self._shift > 0:
            image = torch.cat([self._moved(group) for group in image.chunk(_GROUPS)])
        return image, factors.repeat(1, image.shape[3] // 3).to(image.device)

    def as_images(self, image: Tensor) -> Tensor:
        """Changed images (B, height, width, 3 k) uint8, 255 for white; the argument is that of a call."""
        return (255.0 * (1.0 - self(image))).round_().clamp_(0.0, 255.0).byte().permute(0, 2, 3, 1)

    def _moved(self, image: Tensor) -> Tensor:
        """Images (b, height, width, 3 k), all moved by the same pixels; white comes in from the sides."""
        s = self._shift
        x, y = torch.randint(2 * s + 1, (2,)).tolist()
        height, width = image.shape[1:3]
        padded = torch.nn.functional.pad(image, (0, 0, s, s, s, s), value=255)
        return padded[:, y : y + height, x : x + width]
