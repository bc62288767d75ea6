# SPDX-License-Identifier: MIT
"""Ways of a pusher past an object that rests, to where an episode begins, for a further try."""

import math
from itertools import pairwise

import numpy as np


def way_past(
    p_WO: np.ndarray, begin: np.ndarray, end: np.ndarray, clear: tuple[float, float], longest: float
) -> np.ndarray:
    """Points (n + 1, 3) m, world, on a way from `begin` to `end` that does not touch an object.

    The way is straight where that keeps clear of the object. Else it goes up, straight on over the object, and down.
    A way around would have two directions, between which a policy that imitates them takes the mean.

    Args:
        p_WO: (3,) m, world: origin of the object.
        begin: (3,) m, world: outside of the object.
        end: (3,) m, world: outside of the object.
        clear: m: level distance from the origin, and height in the world, from each of which on nothing is touched.
        longest: m, between two points at most.
    """
    radius, height = clear
    corners = [begin, end]
    if min(begin[2], end[2]) < height and _distance(p_WO[:2], begin[:2], end[:2]) < radius:
        top = max(height, begin[2])
        corners = [begin, np.array([*begin[:2], top]), np.array([*end[:2], top]), end]
    parts = [begin[None]]
    for a, b in pairwise(corners):
        number = math.ceil(float(np.linalg.norm(b - a)) / longest - 1e-9)
        parts.append(np.linspace(a, b, number + 1)[1:])
    return np.concatenate(parts)


def _distance(point: np.ndarray, a: np.ndarray, b: np.ndarray) -> float:
    """Distance of a point from the segment between two others, (2,) each."""
    along = b - a
    share = np.clip((point - a) @ along / max(float(along @ along), 1e-300), 0.0, 1.0)
    return float(np.linalg.norm(a + share * along - point))
