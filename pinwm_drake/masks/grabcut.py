# SPDX-License-Identifier: MIT
"""GrabCut of a photo from a guess of where the object is."""

import cv2
import numpy as np

_MARGIN, _ITERATIONS, _FEWEST = 25, 4, 30  # px around the guess; rounds; px of object and background that it takes
BACKGROUND, OBJECT, MAYBE_BACKGROUND, MAYBE_OBJECT = cv2.GC_BGD, cv2.GC_FGD, cv2.GC_PR_BGD, cv2.GC_PR_FGD


def cut_out(image: np.ndarray, guess: np.ndarray) -> np.ndarray:
    """Mask (H, W) bool of an object by its colours and edges; always the same for the same input.

    Args:
        image: (H, W, 3) uint8, sRGB.
        guess: (H, W) uint8 of `BACKGROUND`, `OBJECT`, `MAYBE_BACKGROUND` and `MAYBE_OBJECT`.

    Source: Rother, Kolmogorov and Blake, "GrabCut" (2004), as OpenCV has it.
    """
    found = np.zeros(guess.shape, bool)
    rows, columns = np.nonzero(guess != BACKGROUND)
    if not len(rows):
        return found
    top, left = max(rows.min() - _MARGIN, 0), max(columns.min() - _MARGIN, 0)
    window = np.s_[top : rows.max() + _MARGIN, left : columns.max() + _MARGIN]
    labels = guess[window].copy()
    objects = int(_is_object(labels).sum())
    if min(objects, labels.size - objects) >= _FEWEST:
        cv2.setRNGSeed(0)
        bgr = np.ascontiguousarray(image[window][..., ::-1])
        models = np.zeros((1, 65)), np.zeros((1, 65))
        cv2.grabCut(bgr, labels, (0, 0, 1, 1), *models, _ITERATIONS, cv2.GC_INIT_WITH_MASK)
    found[window] = _is_object(labels)
    return found


def _is_object(labels: np.ndarray) -> np.ndarray:
    return (labels == OBJECT) | (labels == MAYBE_OBJECT)


def grown(mask: np.ndarray, reach: int) -> np.ndarray:
    """Mask (H, W) bool with a rim of so many px; without one, where the number is negative."""
    if reach == 0:
        return mask
    kernel = np.ones((2 * abs(reach) + 1,) * 2, np.uint8)
    change = cv2.dilate if reach > 0 else cv2.erode
    return change(mask.astype(np.uint8), kernel) > 0
