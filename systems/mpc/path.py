# SPDX-License-Identifier: MIT
"""Steps of the pusher that touch nothing."""

import numpy as np

from pinwm_drake.systems.mpc.model import PlanarBody, rotated
from pinwm_drake.systems.mpc.outline import Outline

_AWAY = np.stack([np.cos(a := np.linspace(0, 2 * np.pi, 16, endpoint=False)), np.sin(a)], axis=1)
_PARTS = (1.0, 0.7, 0.4, 0.2)  # shares of the longest step, tried in this order
_LOOKS = 5  # times in an action at which the room around the pusher is checked
_NEARER = 2e-4  # m, by which a pusher that is too near may come nearer
_SHORT = 1e-3  # m, by which there may be less room beside a moving object than beside one at rest
_CLEAR, _ROUND = 3e-3, 5e-3  # m, off the object: at least, and at corners
_SAMPLES = 24  # points of a straight piece that are checked


class Walk:
    """Way of the pusher round an object that nothing pushes, at rest or on its way there.

    Arguments are those of `PushPlanner`; `detours` are the ways around the object at rest.
    """

    def __init__(self, body: PlanarBody, max_translation: float, low: np.ndarray, high: np.ndarray) -> None:
        self.detours = Detours(body.outline, body.radius)
        self._body, self._longest, self._low, self._high = body, max_translation, low, high

    def step(self, x: np.ndarray, p: np.ndarray, rest: np.ndarray, end: np.ndarray) -> np.ndarray:
        """Return the translation (2) m, world, of one action toward a point, round the moving object.

        Args:
            x: (6) planar state.
            p: (2) m, world: position of the pusher.
            rest: (3) m and rad, pose of B in which the object comes to rest.
            end: (2) m, world: point to go to.
        """
        seen = (rotated(point - rest[:2], -rest[2]) for point in (p, end))
        way = rest[:2] + rotated(self.detours.way(*seen), rest[2])
        wishes = [_cut(way, part * self._longest) for part in _PARTS]
        wishes += [np.zeros(2), *(self._longest * _AWAY), *(_PARTS[2] * self._longest * _AWAY)]
        tried = np.stack([self.allowed(p, wish) for wish in wishes])
        outline, shares = self._body.outline, np.arange(1, _LOOKS + 1) / _LOOKS
        room = np.full(len(tried), np.inf)
        for share, pose in zip(shares, self._ahead(x), strict=True):
            room = np.minimum(room, outline.nearest(rotated(p + share * tried - pose[:2], -pose[2]))[0])
        now = float(outline.nearest(rotated(p - x[:2], -x[2])[None])[0][0])
        enough = np.flatnonzero(room > min(self.detours.clear - _SHORT, now - _NEARER))
        return np.asarray(tried[enough[0] if len(enough) else int(np.argmax(room))])

    def allowed(self, p: np.ndarray, d_W: np.ndarray) -> np.ndarray:
        """Return the translation (2) m like d_W (2) m, cut to the longest and to the box around p (2) m."""
        d_W = d_W * min(1.0, self._longest / max(float(np.hypot(*d_W)), 1e-12))
        # A pusher that is outside may stay or come back.
        return np.asarray(np.clip(p + d_W, np.minimum(self._low, p), np.maximum(self._high, p)) - p)

    def _ahead(self, x: np.ndarray) -> np.ndarray:
        """Poses of B (_LOOKS, 3), m and rad, of an object that nothing pushes, in the next action."""
        poses, pose, v = [], x[:3].copy(), x[3:].copy()
        h = self._body.horizon / _LOOKS
        for _ in range(_LOOKS):
            speed = float(np.hypot(np.hypot(v[0], v[1]), self._body.lever * v[2]))
            v = v * (1.0 - min(h * self._body.braking / max(speed, 1e-9), 1.0))
            pose = pose + h * v
            poses.append(pose)
        return np.array(poses)


def _cut(way: np.ndarray, length: float) -> np.ndarray:
    """Return the translation (2) m along a way (k, 2) m, to the next corner or as far as a length [m]."""
    for corner in way[1:]:
        to = corner - way[0]
        far = float(np.hypot(*to))
        if far > 1e-4:
            cut: np.ndarray = to * min(1.0, length / far)
            return cut
    return np.zeros(2)


class Detours:
    """Shortest ways of a disc around an outline, in the outline's frame: straight pieces from corner to corner.

    Args:
        outline: Outline of the object.
        radius: m, radius of the disc.

    Attributes:
        clear: m, from the outline to the middle of a disc that is far enough off.
    """

    def __init__(self, outline: Outline, radius: float) -> None:
        self._outline, self.clear = outline, radius + _CLEAR
        nodes = outline.corner_points(radius + _ROUND)
        self._nodes = nodes[outline.nearest(nodes)[0] > self.clear]
        self._between = self._straight(self._nodes, self._nodes)
        for k in range(len(self._nodes)):
            self._between = np.minimum(self._between, self._between[:, k : k + 1] + self._between[k])

    def lengths(self, starts: np.ndarray, ends: np.ndarray) -> np.ndarray:
        """Lengths (m, k) m of the shortest ways from starts (m, 2) m to ends (k, 2) m; infinite where there is none."""
        starts = self.outside(starts)
        there = self._straight(starts, self._nodes)
        here = self._straight(self._nodes, ends)
        around = (there[:, :, None] + self._between).min(axis=1)
        around = (around[:, :, None] + here).min(axis=1)
        return np.minimum(self._straight(starts, ends), around)

    def way(self, start: np.ndarray, end: np.ndarray) -> np.ndarray:
        """Corners (k, 2) m of the shortest way from start (2) m to end (2) m, both included.

        A disc that is too near first goes straight out. Where there is no way, it goes straight to the end.
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
        """Points (m, 2) m of which those that are too near are moved straight out."""
        distance, out = self._outline.nearest(points)
        return np.asarray(points + np.maximum(self.clear + 1e-4 - distance, 0.0)[:, None] * out)

    def _straight(self, starts: np.ndarray, ends: np.ndarray) -> np.ndarray:
        """Lengths (m, k) m of the straight ways from starts (m, 2) m to ends (k, 2) m; infinite through the object."""
        share = np.linspace(0.0, 1.0, _SAMPLES)[:, None]
        pieces = starts[:, None, None] + share * (ends[None, :, None] - starts[:, None, None])
        distance = self._outline.nearest(pieces.reshape(-1, 2))[0].reshape(len(starts), len(ends), _SAMPLES)
        length = np.linalg.norm(ends[None] - starts[:, None], axis=2)
        # The ends themselves may be as near as they are.
        return np.where(distance.min(axis=2) > self.clear - 5e-4, length, np.inf)
