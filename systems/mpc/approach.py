# SPDX-License-Identifier: MIT
"""Ways of a pusher around or over an object that rests, to where an episode begins, for a further try."""

import math

import numpy as np

_CLEAR = 0.02  # m, by which a way keeps farther from the axis than its nearer end does, at most


def around(p_WO: np.ndarray, begin: np.ndarray, end: np.ndarray, longest: float) -> np.ndarray:
    """Points (n + 1, 3) m, world, on a way from `begin` to `end` around a vertical axis, `longest` [m] apart at most.

    Args:
        p_WO: (3,) m, world: a point of the axis, of an object that both ends are outside of.
        begin: (3,) m, world.
        end: (3,) m, world.
        longest: m.
    """
    away = np.array([begin, end]) - p_WO
    radii, angles = np.hypot(away[:, 0], away[:, 1]), np.arctan2(away[:, 1], away[:, 0])
    turn = math.remainder(float(angles[1] - angles[0]), 2.0 * math.pi)
    least = max(math.ceil(float(np.linalg.norm(end - begin)) / longest), math.ceil(abs(turn)), 1)
    number = least
    while True:
        shares = np.linspace(0.0, 1.0, number + 1)
        # A chord is nearer to the axis than its ends.
        clear = (radii.min() + min(_CLEAR, 0.5 * longest)) / math.cos(0.5 * turn / number)
        radius = np.maximum(radii[0] + shares * (radii[1] - radii[0]), clear)
        radius[[0, -1]] = radii
        angle = angles[0] + shares * turn
        heights = begin[2] + shares * (end[2] - begin[2])
        points = np.stack([p_WO[0] + radius * np.cos(angle), p_WO[1] + radius * np.sin(angle), heights], axis=1)
        if np.linalg.norm(np.diff(points, axis=0), axis=1).max() <= longest:
            return points
        number += 1


def over(begin: np.ndarray, end: np.ndarray, longest: float) -> np.ndarray:
    """Points (n + 1, 3) m, world, on a level way from `begin` to above `end` and down, `longest` [m] apart at most.

    Args:
        begin: (3,) m, world, higher than what is below.
        end: (3,) m, world.
        longest: m.
    """
    corner = np.array([*end[:2], begin[2]])
    parts = [np.linspace(a, b, _number(a, b, longest) + 1) for a, b in ((begin, corner), (corner, end))]
    return np.concatenate([parts[0], parts[1][1:]])


def _number(begin: np.ndarray, end: np.ndarray, longest: float) -> int:
    return max(math.ceil(float(np.linalg.norm(end - begin)) / longest - 1e-9), 1)
