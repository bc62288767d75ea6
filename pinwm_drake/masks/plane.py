# SPDX-License-Identifier: MIT
"""Differences of photos from the table: the other photos, warped by the table's homography, are the background."""

import warnings
from collections.abc import Sequence

import cv2
import numpy as np

from pinwm_drake.masks.shots import Shot

UNSEEN = 99.0  # difference of a pixel that too few other photos show
_OTHERS, _FEWEST = 12, 3  # photos that each one is compared with, and that have to show a pixel
_RANK = 35.0  # %, of the differences from the other photos: a few of them see the object at that place too
_SHADE = 0.25  # weight of the square of a difference in lightness: shadows and lamps change it
_LEAST_OVERLAP = 0.1  # share of a photo
_LEAST, _OF_NOISE, _NOISE_RANK = 7.0, 3.0, 40.0  # threshold: Lab units, times the noise, and its rank in %


def differences(shots: Sequence[Shot], floor: float) -> list[np.ndarray]:
    """Differences of photos from the table as the others show it, (H, W) float32 each, in units of Lab.

    A table shows the same in all photos, a thing on it does not, and nor does what is beyond the table.

    Args:
        shots: Photos of a thing that stands on a table, three or more.
        floor: Height of the table, m, world.
    """
    planes = [shot.P @ np.array([[1, 0, 0], [0, 1, 0], [0, 0, floor], [0, 0, 1.0]]) for shot in shots]
    half = [_soft(shot.image) for shot in shots]
    to_half = [np.diag([0.5, 0.5, 1.0]) + np.array([[0, 0, -0.25], [0, 0, -0.25], [0, 0, 0]]) for _ in shots]
    planes = [to @ plane for to, plane in zip(to_half, planes, strict=True)]
    found = []
    for i, shot in enumerate(shots):
        steps = np.unique(np.linspace(1, len(shots) - 1, min(_OTHERS, len(shots) - 1)).round().astype(int))
        others = [(i + step) % len(shots) for step in steps]
        layers = [_difference(half[i], half[j], planes[j] @ np.linalg.inv(planes[i])) for j in others]
        layers = [layer for layer in layers if layer is not None]
        small = _ranked(np.array(layers)) if len(layers) >= _FEWEST else np.full(half[i].shape[:2], UNSEEN, np.float32)
        found.append(cv2.resize(small, shot.shape[::-1], interpolation=cv2.INTER_LINEAR))
    return found


def threshold(found: Sequence[np.ndarray]) -> float:
    """Difference above which pixels are no table, from the differences (H, W) of all photos."""
    seen = np.concatenate([layer[layer < UNSEEN] for layer in found])
    noise = float(np.percentile(seen, _NOISE_RANK)) if len(seen) else 0.0
    return max(_LEAST, _OF_NOISE * noise)


def _soft(image: np.ndarray) -> np.ndarray:
    size = max(image.shape[1] // 2, 1), max(image.shape[0] // 2, 1)
    lab = cv2.cvtColor(cv2.resize(image, size, interpolation=cv2.INTER_AREA), cv2.COLOR_RGB2LAB)
    return cv2.GaussianBlur(lab, (0, 0), 0.7).astype(np.float32)


def _difference(image: np.ndarray, other: np.ndarray, homography: np.ndarray) -> np.ndarray | None:
    """Least difference within one pixel from another photo; NaN where that shows nothing, None for too little of it."""
    height, width = image.shape[:2]
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    warped = cv2.warpPerspective(other, homography, (width, height), flags=flags, borderValue=(-999.0,) * 3)
    missing = warped[..., 0] < -1
    # Behind the other camera a homography has points too.
    rows, columns = np.mgrid[0:height, 0:width]
    missing |= homography[2, 0] * columns + homography[2, 1] * rows + homography[2, 2] <= 0
    if 1 - missing.mean() < _LEAST_OVERLAP:
        return None
    warped += np.median((image - warped)[~missing][::3], axis=0)  # the exposure
    padded = cv2.copyMakeBorder(warped, 1, 1, 1, 1, cv2.BORDER_REPLICATE)
    least = np.full((height, width), np.inf, np.float32)
    for dy in range(3):
        for dx in range(3):
            e = image - padded[dy : dy + height, dx : dx + width]
            np.minimum(least, _SHADE * e[..., 0] ** 2 + e[..., 1] ** 2 + e[..., 2] ** 2, out=least)
    least = np.sqrt(least)
    least[missing] = np.nan
    return least


def _ranked(layers: np.ndarray) -> np.ndarray:
    """Difference of a rank among those that are there, (k, H, W) to (H, W)."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        ordered = np.sort(layers, axis=0)  # NaN last
    number = np.isfinite(ordered).sum(axis=0)
    rank = np.clip((number * _RANK / 100).astype(int), 0, len(layers) - 1)
    return np.where(number < _FEWEST, UNSEEN, np.take_along_axis(ordered, rank[None], 0)[0]).astype(np.float32)
