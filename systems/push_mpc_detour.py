"""Ways for the pusher around an object without touching it."""

import numpy as np

from pinwm_drake.systems.push_mpc_outline import Outline

_CLEAR, _ROUND = 3e-3, 5e-3  # m, off the object: at least, and at corners
_SAMPLES = 24  # of a straight piece


class Detours:
    """Shortest ways of a disc around an outline, in the outline's frame: straight pieces from corner to corner.

    Attributes:
        clear: m, from the outline to the middle of a disc that is far enough off.
    """

    def __init__(self, outline: Outline, radius: float) -> None:
        """Finds the ways between corners.

        Args:
            outline: The object.
            radius: m, of the disc.
        """
        self._outline, self.clear = outline, radius + _CLEAR
        nodes = outline.corner_points(radius + _ROUND)
        self._nodes = nodes[outline.nearest(nodes)[0] > self.clear]
        self._between = self._straight(self._nodes, self._nodes)
        for k in range(len(self._nodes)):
            self._between = np.minimum(self._between, self._between[:, k : k + 1] + self._between[k])

    def lengths(self, starts: np.ndarray, ends: np.ndarray) -> np.ndarray:
        """(m, k) m: of the shortest ways from starts (m, 2) to ends (k, 2); infinite where there is none."""
        starts = self.outside(starts)
        there = self._straight(starts, self._nodes)
        here = self._straight(self._nodes, ends)
        around = (there[:, :, None] + self._between).min(axis=1)
        around = (around[:, :, None] + here).min(axis=1)
        return np.minimum(self._straight(starts, ends), around)

    def way(self, start: np.ndarray, end: np.ndarray) -> np.ndarray:
        """(k, 2) m: corners of the shortest way from start (2) to end (2), both included; straight where there is none.

        It begins where the disc is far enough off, if it is too near.
        """
        begin = self.outside(start[None])
        points, here = [start], begin[0]
        if np.hypot(*(here - start)) > 1e-6:
            points.append(here)
        to_end = self._straight(self._nodes, end[None])[:, 0]
        left = (self._between + to_end).min(axis=1)
        visited: set[int] = set()
        while True:
            ahead = self._straight(here[None], np.vstack([end, self._nodes]))[0]
            total = ahead + np.concatenate([[0.0], left])
            total[[1 + node for node in visited]] = np.inf
            best = int(np.argmin(total))
            if best == 0 or not np.isfinite(total[best]):
                return np.array([*points, end])
            visited.add(best - 1)
            here = self._nodes[best - 1]
            points.append(here)

    def outside(self, points: np.ndarray) -> np.ndarray:
        """Points (m, 2), those that are too near moved straight out."""
        distance, out = self._outline.nearest(points)
        moved: np.ndarray = points + np.maximum(self.clear + 1e-4 - distance, 0.0)[:, None] * out
        return moved

    def _straight(self, starts: np.ndarray, ends: np.ndarray) -> np.ndarray:
        """(m, k) m: lengths of the straight ways; infinite where the object is in the way."""
        share = np.linspace(0.0, 1.0, _SAMPLES)[:, None]
        pieces = starts[:, None, None] + share * (ends[None, :, None] - starts[:, None, None])
        distance = self._outline.nearest(pieces.reshape(-1, 2))[0].reshape(len(starts), len(ends), _SAMPLES)
        length = np.linalg.norm(ends[None] - starts[:, None], axis=2)
        # The ends themselves may be as near as they are.
        return np.where(distance.min(axis=2) > self.clear - 5e-4, length, np.inf)
