# SPDX-License-Identifier: MIT
"""Colours of an object against those around it."""

import cv2
import numpy as np

_BINS = 8, 32, 32  # of lightness, a and b in OpenCV's Lab of bytes
_RARE = 0.5  # pixels of every colour that nobody has seen
_BLUR = 1.0  # bins of a and b


def histogram(lab: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Numbers of pixels by their colours, from a picture (H, W, 3) uint8 in Lab and a mask (H, W) bool."""
    return cv2.calcHist([lab], [0, 1, 2], mask.astype(np.uint8), list(_BINS), [0, 256] * 3)


def evidence(lab: np.ndarray, object_counts: np.ndarray, other_counts: np.ndarray) -> np.ndarray:
    """Logarithm of how much likelier a pixel's colour is on the object than elsewhere, (H, W) float32.

    Args:
        lab: (H, W, 3) uint8 in Lab.
        object_counts: Histogram of the object.
        other_counts: Histogram of what is around it.
    """
    ratio = np.log(_density(object_counts) / _density(other_counts))
    return ratio[tuple(lab[..., k] >> (8 - bits) for k, bits in enumerate((3, 5, 5)))]


def _density(counts: np.ndarray) -> np.ndarray:
    soft = np.stack([cv2.GaussianBlur(layer, (0, 0), _BLUR) for layer in counts.astype(np.float32)]) + _RARE / 100
    return soft / soft.sum()
