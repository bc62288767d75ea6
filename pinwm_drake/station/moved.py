# SPDX-License-Identifier: MIT
"""Signs that a camera was moved between two photos: what stands still in its images, and the robot's poses."""

from collections.abc import Sequence
from itertools import pairwise

import cv2
import numpy as np
from scipy.stats import f as fisher

from pinwm_drake.spatial.rigid import inverse, turn
from pinwm_drake.station.accuracy import degrees_of_freedom
from pinwm_drake.station.board import Seen
from pinwm_drake.station.solve import Solution

_MOST_POINTS, _FEWEST_POINTS = 200, 30
_BACK = 0.5  # px, by which a point that is tracked there and back may miss
# Least motions that count, px: points are tracked to 0.1 px, and matched to a pixel.
_MOVED, _MOVED_FAR = 0.5, 2.0
_TRACKED = 0.3  # of the points, that are tracked where motions are short
_TOGETHER = 5.0  # px, by which features that move together may be apart
_SHARE = 0.6  # of the tracked points that have moved
_WINDOW, _LEVELS = (15, 15), 5
_WIDEST = 1280  # px, of the images that are tracked
_FEWEST_PHOTOS = 3  # on each side of a change that the robot's poses show
_SUSPICIOUS = 45.0  # gain of twice the log-likelihood, which has 6 more unknowns and the best of many splits
_BY_CHANCE = 1e-7  # probability of a change where there is none; a camera that is moved is far beyond


class Background:
    """What stands still before a camera that should stand still.

    Args:
        image: First photo (H, W) uint8.
        seen: Its corners of the board.
    """

    def __init__(self, image: np.ndarray, seen: Seen) -> None:
        self._scale = min(1.0, _WIDEST / image.shape[1])
        self._first, self._seen = self._small(image), seen
        self._corners = cv2.goodFeaturesToTrack(self._first, _MOST_POINTS, 0.01, 8, mask=self._outside(seen))

    def _small(self, image: np.ndarray) -> np.ndarray:
        small = cv2.resize(image, None, fx=self._scale, fy=self._scale, interpolation=cv2.INTER_AREA).astype(np.float32)
        # Tracking takes brightness for constant, which automatic exposure does not keep.
        even = (small - small.mean()) / max(float(small.std()), 1.0)
        return np.clip(128.0 + 40.0 * even, 0.0, 255.0).astype(np.uint8)

    def _outside(self, seen: Seen) -> np.ndarray:
        """Mask (h, w) uint8 of the pixels well outside of a board."""
        hull = cv2.convexHull((self._scale * seen.pixels).astype(np.float32)).reshape(-1, 2)
        middle = hull.mean(0)
        mask = np.full(self._first.shape, 255, np.uint8)
        cv2.fillConvexPoly(mask, np.round(middle + 1.6 * (hull - middle)).astype(np.int32), 0)
        return mask

    def move(self, image: np.ndarray, seen: Seen) -> float | None:
        """Motion [px] of most of it up to a photo (H, W) uint8, 0 for none; None where too little is found again."""
        small = self._small(image)
        motions, least = self._tracked(small, seen), _MOVED
        if motions is None:
            motions, least = self._matched(small, seen), _MOVED_FAR
        if motions is None:
            return None
        moved = float((motions > least).mean()) > _SHARE
        return float(np.median(motions)) / self._scale if moved else 0.0

    def _tracked(self, small: np.ndarray, seen: Seen) -> np.ndarray | None:
        """Motions (n,) [px] of points that are tracked there and back, for short ones."""
        if self._corners is None or len(self._corners) < _FEWEST_POINTS:
            return None
        first, corners = self._first, self._corners
        there, good, _ = cv2.calcOpticalFlowPyrLK(first, small, corners, None, winSize=_WINDOW, maxLevel=_LEVELS)  # type: ignore[call-overload]
        back, again, _ = cv2.calcOpticalFlowPyrLK(small, first, there, None, winSize=_WINDOW, maxLevel=_LEVELS)  # type: ignore[call-overload]
        kept = (good.ravel() == 1) & (again.ravel() == 1) & (np.linalg.norm(back - corners, axis=-1).ravel() < _BACK)
        places = there.reshape(-1, 2)
        height, width = small.shape
        kept &= (places > 0).all(1) & (places < [width - 1, height - 1]).all(1)
        kept[kept] = self._outside(seen)[places[kept, 1].astype(int), places[kept, 0].astype(int)] > 0
        if kept.sum() < max(_FEWEST_POINTS, _TRACKED * len(kept)):
            return None
        motions: np.ndarray = np.linalg.norm(places - corners.reshape(-1, 2), axis=1)[kept]
        return motions

    def _matched(self, small: np.ndarray, seen: Seen) -> np.ndarray | None:
        """Motions (n,) [px] of features that look alike and move together, however far."""
        orb = cv2.ORB_create(1000)  # type: ignore[attr-defined]
        points, words = orb.detectAndCompute(self._first, self._outside(self._seen))
        others, other_words = orb.detectAndCompute(small, self._outside(seen))
        if words is None or other_words is None:
            return None
        pairs = cv2.BFMatcher(cv2.NORM_HAMMING, crossCheck=True).match(words, other_words)
        if len(pairs) < _FEWEST_POINTS:
            return None
        start = np.array([points[pair.queryIdx].pt for pair in pairs])
        end = np.array([others[pair.trainIdx].pt for pair in pairs])
        _, together = cv2.estimateAffinePartial2D(start, end, ransacReprojThreshold=_TOGETHER)
        if together is None or together.sum() < _FEWEST_POINTS:
            return None
        motions: np.ndarray = np.linalg.norm(end - start, axis=1)[together.ravel() == 1]
        return motions


def first_move(names: Sequence[str], moves: Sequence[float | None]) -> tuple[str, str, float] | None:
    """Names of the photos between which a camera was moved, and by how many px; None where it was not."""
    known = [(name, move) for name, move in zip(names, moves, strict=True) if move is not None]
    for (before, _), (after, move) in pairwise(known):
        if move > 0.0:
            return before, after, move
    return None


def likely_change(X: Sequence[np.ndarray]) -> int | None:
    """Number of the pose (4, 4) from which on poses that should be equal look like others; None where none does.

    It is cheap and errs towards a change; `is_change` decides.
    """
    middle = inverse(X[len(X) // 2])
    values = np.array([np.concatenate([(middle @ one)[:3, 3], turn(middle @ one)]) for one in X])
    away = values - np.median(values, 0)
    values = np.clip(away / (1.4826 * np.median(np.abs(away), 0) + 1e-9), -10.0, 10.0)

    def loss(part: np.ndarray) -> np.ndarray:
        return ((part - part.mean(0)) ** 2).sum(0)

    splits = range(_FEWEST_PHOTOS, len(X) - _FEWEST_PHOTOS + 1)
    losses = {k: float(np.log(loss(values[:k]) + loss(values[k:])).sum()) for k in splits}
    if not losses:
        return None
    best = min(losses, key=losses.__getitem__)
    return best if len(X) * (float(np.log(loss(values)).sum()) - losses[best]) > _SUSPICIOUS else None


def is_change(solution: Solution) -> bool:
    """Flag: the two poses of the camera, of a solution with a split, are not the same."""
    assert solution.later is not None
    D = inverse(solution.camera.X) @ solution.later.X
    motion = np.concatenate([D[:3, 3], turn(D)])
    before, after = solution.camera.columns, solution.later.columns
    C = solution.covariance
    spread = C[before, before] + C[after, after] - C[before, after] - C[after, before]
    redundancy = max(degrees_of_freedom(solution) - 6.0, 1.0)
    return float(motion @ np.linalg.solve(spread, motion)) > 6.0 * float(fisher.isf(_BY_CHANCE, 6, redundancy))
