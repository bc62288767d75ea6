# SPDX-License-Identifier: MIT
"""Random changes of images that leave what they show as it is, so that a network does not count on exact pixels."""

import torch
from torch import Tensor

_GROUPS = 8  # parts of a batch, each of which is moved alike: one image at a time takes longer than the network


class Augment:
    """Moves images, changes their colours and frays their outlines at random; the background stays white.

    Source: the shift is that of Yarats, Kostrikov and Fergus, "Image augmentation is all you need" (ICLR 2021).
    """

    def __init__(self, shift: int, gain: float, mask: float = 0.0) -> None:
        """Keep the ranges of the changes.

        Args:
            shift: px, largest shift along both axes.
            gain: Relative half-width of a factor for each of red, green and blue, alike in all frames of a stack.
            mask: px, by which masks are too small or too large at the most, up to 1: as a share of the pixels along the
                outline. A stack draws its own share and what is behind the object; a frame differs by up to a third.
        """
        self._shift, self._gain, self._mask = shift, gain, mask

    @property
    def changes_colours_alone(self) -> bool:
        """Flag: nothing is moved or frayed, so that `factors` of the darkness are all that is changed."""
        return not (self._shift or self._mask)

    def factors(self, number: int) -> Tensor:
        """Return random factors (number, 3) of the darkness of red, green and blue."""
        return 1.0 + self._gain * (2.0 * torch.rand(number, 3) - 1.0)

    def __call__(self, image: Tensor) -> Tensor:
        """Return changed images (B, 3 k, height, width) float32, 0 for white and 1 for black; torch draws.

        Args:
            image: (B, height, width, 3 k) uint8, RGB.
        """
        dark: Tensor = self.as_images(image).permute(0, 3, 1, 2).to(torch.float32, copy=True).sub_(255.0).div_(-255.0)
        return dark

    def as_images(self, image: Tensor) -> Tensor:
        """Return the changed images (B, height, width, 3 k) uint8, 255 for white; the argument is that of a call."""
        B, k = len(image), image.shape[3] // 3
        factors = self.factors(B)
        if self._mask > 0.0:
            image = self._frayed(image)
        if self._shift > 0:
            image = torch.cat([self._moved(group) for group in image.chunk(_GROUPS)])
        if self._gain > 0.0:
            dark = image.to(torch.float32).sub_(255.0).mul_(factors.repeat(1, k).to(image.device)[:, None, None])
            image = dark.add_(255.5).clamp_(0.0, 255.0).to(torch.uint8)
        return image

    def _frayed(self, image: Tensor) -> Tensor:
        """Images (B, height, width, 3 k) whose outlines lack pixels of the object, or have some of what is behind."""
        B, height, width, channels = image.shape
        red, green, blue = (image[..., channel::3] for channel in range(3))
        shown = (red & green & blue) < 255  # (B, height, width, k)
        share = self._mask * (2.0 * torch.rand(B, 1, device=image.device) - 1.0)
        share = share + self._mask / 3.0 * (2.0 * torch.rand(B, channels // 3, device=image.device) - 1.0)
        share = share.clamp(-self._mask, self._mask)[:, None, None]
        # Pixels of the object beside what is not, where its share is to be lost, and the other way round.
        smaller = share < 0.0
        edge = (shown == smaller) & _beside(shown != smaller)
        at = edge.nonzero(as_tuple=True)
        wrong = torch.rand(len(at[0]), device=image.device) < share.abs().expand(shown.shape)[at]
        stack, row, column, frame = (part[wrong] for part in at)
        behind = torch.randint(255, (B, 3), dtype=torch.uint8, device=image.device)[stack]
        frayed = image.clone()
        pixels = frayed.view(B, height, width, channels // 3, 3)
        pixels[stack, row, column, frame] = behind.masked_fill(smaller[stack, 0, 0, frame, None], 255)
        return frayed

    def _moved(self, image: Tensor) -> Tensor:
        """Images (b, height, width, 3 k), all moved by the same pixels; white comes in from the sides."""
        s = self._shift
        x, y = torch.randint(2 * s + 1, (2,)).tolist()
        height, width = image.shape[1:3]
        padded = torch.nn.functional.pad(image, (0, 0, s, s, s, s), value=255)
        return padded[:, y : y + height, x : x + width]


def _beside(mask: Tensor) -> Tensor:
    """Mask (B, height, width, k) of the pixels with a neighbour, above, below, left or right, that is in a mask."""
    beside = torch.zeros_like(mask)
    beside[:, 1:] |= mask[:, :-1]
    beside[:, :-1] |= mask[:, 1:]
    beside[:, :, 1:] |= mask[:, :, :-1]
    beside[:, :, :-1] |= mask[:, :, 1:]
    return beside
