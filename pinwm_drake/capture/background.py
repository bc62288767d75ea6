# SPDX-License-Identifier: MIT
"""Masks of objects that were cut out by alpha, or stand on a white background."""

from pathlib import Path

import cv2
import numpy as np

from pinwm_drake.errors import InputError

ALPHA = 128  # of 255, as in masks: half of a pixel
_UNSURE_ALPHA = 96, 160  # an area in between is neither object nor background
_FAINT_ALPHA = 64  # more than this, and below `ALPHA` all over, may be an object
_UNSURE = 0.02  # share of the object's pixels that may be unsure
# Distances from white, of 255. JPEG leaves steps of 1 to 8 around an object, and single ones of 32 or more.
_STEPS = 8
_DARK = 32
_CLEAN = 0.02  # share of the object's pixels with such steps in a picture without noise
_FAINT = 0.01  # share of the object's pixels that may lie in faint areas
_FRAME = 2  # px, width of the image's border
_MOST_OF_FRAME = 0.5  # share of the border that an object may cover
_ALLOWED = "a plain white background, an alpha channel, or a mask in masks/"


def cut_out(path: Path, alpha: np.ndarray) -> np.ndarray:
    """Mask (H, W) bool of an object that was cut out: alpha is 128 and above.

    Args:
        path: The image, for messages.
        alpha: (H, W) uint8.

    Raises:
        InputError: Areas of it are half transparent, so that alpha does not tell object from background.
    """
    mask = alpha >= ALPHA
    low, high = _UNSURE_ALPHA
    unsure = _areas((alpha >= low) & (alpha <= high))
    if unsure > _UNSURE * mask.sum():
        found = f"a background that is half transparent ({unsure} px of alpha {low} to {high})"
        raise InputError(path, value=found, allowed="alpha near 0 beside the object, or a mask in masks/")
    if not mask.any() and alpha.max() >= _FAINT_ALPHA:
        found = f"no pixel of alpha {ALPHA} or more, and {int(alpha.max())} at most"
        raise InputError(path, value=found, allowed="alpha of 255 on the object, or a mask in masks/")
    return mask


def on_white(path: Path, pixels: np.ndarray) -> np.ndarray:
    """Mask (H, W) bool of an object on white, whether or not JPEG has left noise around it.

    A picture without noise shows the object wherever it is not white, one with noise where a channel is 223 or less.
    Pixels of the outline count where they differ from white by half as much as the object beside them.

    Args:
        path: The image, for messages.
        pixels: (H, W, 3) uint8, sRGB.

    Raises:
        InputError: The background is not white, or faint areas may be object or background.
    """
    away = 255 - pixels.min(axis=-1)
    if away.min() > 0:
        raise InputError(path, value="no white pixel", allowed=_ALLOWED)
    steps = (away > 0) & (away <= _STEPS)
    if steps.sum() <= _CLEAN * (away > _STEPS).sum():
        mask = _trimmed(away, away > 0, 1)
    else:
        dark = away >= _DARK
        faint = _areas((away >= _STEPS) & ~_grown(dark, 1))
        if faint > _FAINT * dark.sum():
            found = f"a background that is not plain white ({faint} px of areas between {255 - _DARK} and 247)"
            raise InputError(path, value=found, allowed=_ALLOWED)
        mask = _trimmed(away, dark, 2)
    border = np.ones_like(mask)
    border[_FRAME:-_FRAME, _FRAME:-_FRAME] = False
    if mask[border].mean() > _MOST_OF_FRAME:
        found = f"a background that is not white along {mask[border].mean():.0%} of the image's border"
        raise InputError(path, value=found, allowed=_ALLOWED)
    return mask


def _trimmed(away: np.ndarray, mask: np.ndarray, reach: int) -> np.ndarray:
    """Mask without pixels at its outline that are nearer to white than to the darkest pixel within a reach [px]."""
    darkest = cv2.dilate(away, _square(reach)).astype(int)
    return mask & ~(_grown(~mask, reach) & (2 * away.astype(int) < darkest))


def _areas(pixels: np.ndarray) -> int:
    """Number of pixels (H, W) bool in areas of 3 x 3 or more; outlines and ringing are thinner."""
    return int(cv2.morphologyEx(pixels.astype(np.uint8), cv2.MORPH_OPEN, _square(1)).sum())


def _grown(mask: np.ndarray, reach: int) -> np.ndarray:
    return cv2.dilate(mask.astype(np.uint8), _square(reach)) > 0


def _square(reach: int) -> np.ndarray:
    return np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)
