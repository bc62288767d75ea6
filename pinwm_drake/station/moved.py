# SPDX-License-Identifier: MIT
"""Signs that a camera was moved between two photos: what stands still in its images, and the robot's poses."""

from collections.abc import Sequence
from itertools import pairwise

import cv2
import numpy as np

from pinwm_drake.station.board import Seen
from pinwm_drake.station.rigid import inverse, turn

_MOST_POINTS, _FEWEST_POINTS = 200, 30
_BACK = 0.5  # px, by which a point that is tracked there and back may miss
_MOVED = 1.5  # px, the least motion that counts
_SHARE = 0.6  # of the tracked points that have moved
_WINDOW, _LEVELS = (15, 15), 5
_WIDEST = 1280  # px, of the images that are tracked
_FEWEST_PHOTOS = 3  # on each side of a change that the robot's poses show
_SIGNIFICANT = 40.0  # gain of twice the log-likelihood by six more unknowns and their moment; 1e-5 at random is 35
_FAR = 4.0  # standard deviations, where the robust loss bends


class Background:
    """What stands still before a camera that should stand still.

    Args:
        image: First photo (H, W) uint8.
        seen: Its corners of the board.
    """

    def __init__(self, image: np.ndarray, seen: Seen) -> None:
        self._scale = min(1.0, _WIDEST / image.shape[1])
        self._first = self._small(image)
        self._corners = cv2.goodFeaturesToTrack(self._first, _MOST_POINTS, 0.01, 8, mask=self._outside(seen))

    def _small(self, image: np.ndarray) -> np.ndarray:
        return cv2.resize(image, None, fx=self._scale, fy=self._scale, interpolation=cv2.INTER_AREA)

    def _outside(self, seen: Seen) -> np.ndarray:
        """Mask (h, w) uint8 of the pixels well outside of a board."""
        hull = cv2.convexHull((self._scale * seen.pixels).astype(np.float32)).reshape(-1, 2)
        middle = hull.mean(0)
        mask = np.full(self._first.shape, 255, np.uint8)
        cv2.fillConvexPoly(mask, np.round(middle + 1.6 * (hull - middle)).astype(np.int32), 0)
        return mask

    def move(self, image: np.ndarray, seen: Seen) -> float | None:
        """Motion [px] of most of it up to a photo (H, W) uint8, 0 for none; None where too little can be tracked."""
        if self._corners is None or len(self._corners) < _FEWEST_POINTS:
            return None
        small, corners = self._small(image), self._corners
        there, good, _ = cv2.calcOpticalFlowPyrLK(self._first, small, corners, None, winSize=_WINDOW, maxLevel=_LEVELS)  # type: ignore[call-overload]
        back, again, _ = cv2.calcOpticalFlowPyrLK(small, self._first, there, None, winSize=_WINDOW, maxLevel=_LEVELS)  # type: ignore[call-overload]
        kept = (good.ravel() == 1) & (again.ravel() == 1) & (np.linalg.norm(back - corners, axis=-1).ravel() < _BACK)
        places = there.reshape(-1, 2)
        height, width = small.shape
        kept &= (places > 0).all(1) & (places < [width - 1, height - 1]).all(1)
        kept[kept] = self._outside(seen)[places[kept, 1].astype(int), places[kept, 0].astype(int)] > 0
        if kept.sum() < _FEWEST_POINTS:
            return None
        motions = np.linalg.norm(places - corners.reshape(-1, 2), axis=1)[kept]
        moved = float((motions > _MOVED).mean()) > _SHARE
        return float(np.median(motions)) / self._scale if moved else 0.0


def first_move(names: Sequence[str], moves: Sequence[float | None]) -> tuple[str, str, float] | None:
    """Names of the photos between which a camera was moved, and by how many px; None where it was not."""
    known = [(name, move) for name, move in zip(names, moves, strict=True) if move is not None]
    for (before, _), (after, move) in pairwise(known):
        if move > 0.0:
            return before, after, move
    return None


def likely_change(X: Sequence[np.ndarray]) -> int | None:
    """Number of the pose (4, 4) from which on poses that should be equal are others; None for too few.

    The poses may be as they were; see `gain` for whether a change is one.
    """
    middle = inverse(X[len(X) // 2])
    values = np.array([np.concatenate([(middle @ one)[:3, 3], turn(middle @ one)]) for one in X])
    away = values - np.median(values, 0)
    spread = 1.4826 * np.median(np.abs(away), 0) + 1e-9
    values = np.clip(away / spread, -10.0, 10.0)
    losses = {
        k: sum(float(((part - np.median(part, 0)) ** 2).sum()) for part in (values[:k], values[k:]))
        for k in range(_FEWEST_PHOTOS, len(X) - _FEWEST_PHOTOS + 1)
    }
    return min(losses, key=losses.__getitem__) if losses else None


def gain(whole: np.ndarray, split: np.ndarray, spread: np.ndarray) -> float:
    """Gain of twice the log-likelihood by a change, from the errors of the told poses.

    Args:
        whole: (n, 6) m and rad, errors without the change.
        split: (n, 6), with it.
        spread: (6,), standard deviations with it.
    """

    def loss(errors: np.ndarray) -> float:
        square = ((errors / spread) ** 2).sum(1)
        return float((6.0 * _FAR**2 * np.log1p(square / (6.0 * _FAR**2))).sum())

    return loss(whole) - loss(split)


def is_change(found: float) -> bool:
    """Flag: a gain is that of a camera that was moved."""
    return found > _SIGNIFICANT
