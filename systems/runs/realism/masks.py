# SPDX-License-Identifier: MIT
"""Mistakes of pictures: masks that are too small or too large and flicker, and motion that blurs."""

from collections.abc import Iterable

import cv2
import numpy as np

_PATCH = 24  # px, of the noise along an outline
_UNEVEN = 0.4  # px, standard deviation of that noise
_TONE, _TINT = (90, 200), 25  # of what is behind the object


def draw_behind(generator: np.random.Generator) -> np.ndarray:
    """Colour (3,) uint8 of what is behind an object, drawn at random: a grey with a tint."""
    tone = generator.uniform(*_TONE) + generator.uniform(-_TINT, _TINT, 3)
    return np.clip(tone, 0, 255).astype(np.uint8)


def ragged(
    picture: np.ndarray, wider: float, behind: np.ndarray, generator: np.random.Generator, *, most: float
) -> np.ndarray:
    """Picture with a mask that is not quite the object's.

    Args:
        picture: (H, W, 4) uint8, alpha 255 on the object.
        wider: px, by which the mask is too wide all around; too narrow where negative.
        behind: (3,) uint8, colour of what is behind the object: it is in the picture where the mask is too wide.
        generator: Source of noise along the outline.
        most: px, by which the mask is wrong anywhere, at the most.

    Returns:
        (H, W, 4) uint8, alpha 255 within the mask; white and 0 elsewhere.
    """
    shown = (picture[..., 3] > 127).astype(np.uint8)
    if not shown.any():
        return picture.copy()
    inside, outside = (cv2.distanceTransform(mask, cv2.DIST_L2, 5) for mask in (shown, 1 - shown))
    # Distance to the outline, which runs between pixels: positive within.
    depth = np.where(shown > 0, inside - 0.5, 0.5 - outside)
    height, width = shown.shape
    coarse = generator.normal(0.0, _UNEVEN, (height // _PATCH + 2, width // _PATCH + 2)).astype(np.float32)
    noise = cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC)
    mask = depth > -np.clip(wider + noise, -most, most)
    result = np.full_like(picture, (255, 255, 255, 0))
    result[mask] = np.where(shown[mask, None] > 0, picture[mask], np.append(behind, 255))
    result[mask, 3] = 255
    return result


def blurred(pictures: Iterable[np.ndarray], behind: np.ndarray) -> np.ndarray:
    """Picture of an exposure from pictures of its moments.

    Args:
        pictures: (H, W, 4) uint8 each, alpha 255 on the object; one or more.
        behind: (3,) uint8, colour of what is behind the object.

    Returns:
        (H, W, 4) uint8: alpha 255 where the object was half of the time or more, with the mean colour; white, 0
        elsewhere.
    """
    stack = np.stack(list(pictures)).astype(np.float32)
    on = stack[..., 3:] > 127
    colour = np.where(on, stack[..., :3], behind.astype(np.float32)).mean(axis=0)
    mask = on[..., 0].mean(axis=0) >= 0.5
    result = np.full(stack.shape[1:], (255, 255, 255, 0), np.uint8)
    result[mask, :3] = np.round(colour[mask]).astype(np.uint8)
    result[mask, 3] = 255
    return result
