# SPDX-License-Identifier: MIT
"""Limiter of a pusher's velocity, sample by sample: box, speed and acceleration; plain numpy, without Drake."""

import math

import numpy as np

from pinwm_drake.errors import require
from pinwm_drake.learning.safety import SafetyLimits

# By this share a velocity may exceed a limit: a limit that is just what is asked for is not to alter it by rounding.
_ROUNDING = 1e-9


class VelocityLimiter:
    """Limiter that finds the velocity nearest to the one wanted which keeps the limits, when sampled every T and held.

    In the order of their weight:

    1. Box. Each component is such that the pusher is in the box one period later, and can be stopped before the wall
       with a share of 1/sqrt(3) of the acceleration, the others' axes with the like at the same time: with d the
       change that this allows in a period, the largest v with (v + (v - d) + (v - 2 d) + ...) T <= distance. A pusher
       that is outside already may only stay or come back.
    2. Speed. A velocity that is too large is shortened; its direction is kept.
    3. Acceleration. From what the box forces of the velocity before, go towards the velocity wanted as far as allowed.

    Velocities that this class gave, with a pusher that moved by them, keep all three exactly, to 1e-9 of a limit. Where
    something else has moved the pusher, the box goes before the acceleration.

    Args:
        limits: Limits of box, speed and acceleration.
        period: Period T of the samples, s.

    Raises:
        ParameterError: The period is not positive.
    """

    def __init__(self, limits: SafetyLimits, period: float) -> None:
        require("period", f"{period:g} s", 0 < period < math.inf, "more than 0 s")
        self._period = period
        self._low, self._high = np.array(limits.box_low), np.array(limits.box_high)
        self._speed = limits.max_speed
        self._change = limits.max_acceleration * period
        self._braking = self._change / math.sqrt(3.0)

    def limit(self, wanted: np.ndarray, before: np.ndarray, p_WP: np.ndarray) -> np.ndarray:
        """Limited velocity (3,) m/s of the coming period; all arguments finite, world frame.

        Args:
            wanted: (3,) m/s.
            before: (3,) m/s, of the last period.
            p_WP: (3,) m, where the pusher is.
        """
        up = stoppable(self._high - p_WP, self._braking, self._period)
        down = -stoppable(p_WP - self._low, self._braking, self._period)
        least = np.clip(before, down, up)
        goal = np.clip(self.shortened(wanted), down, up)
        share = self._share(least - before, goal - least)
        # To the last bit where there is nothing to limit, as in training.
        return goal if share == 1.0 else least + share * (goal - least)

    def shortened(self, v: np.ndarray) -> np.ndarray:
        """Velocity (3,) m/s, shortened to the largest speed; finite, its direction is kept."""
        largest = float(np.abs(v).max())
        if largest == 0.0:
            return v
        # Divided by the largest component first, which is safe against overflow.
        length = largest * float(np.linalg.norm(v / largest))
        if length <= self._speed * (1.0 + _ROUNDING):
            return v
        return np.asarray(v / largest * (self._speed / float(np.linalg.norm(v / largest))))

    def _share(self, first: np.ndarray, way: np.ndarray) -> float:
        """Share, 0 to 1, of a change of velocity `way` (3,) m/s that may follow the change `first`."""
        if np.linalg.norm(first + way) <= self._change * (1.0 + _ROUNDING):
            return 1.0
        # |first + s way|^2 = change^2. The norm is convex, so that the larger solution is the one ahead.
        a, b = float(way @ way), float(first @ way)
        room = self._change**2 - float(first @ first)
        if room <= 0.0 or a == 0.0:
            return 0.0
        return min(max((math.sqrt(b * b + a * room) - b) / a, 0.0), 1.0)


def stoppable(distance: np.ndarray, change: np.ndarray | float, period: float) -> np.ndarray:
    """Largest speeds (n,) from which a motion that is sampled and held stops within distances.

    Args:
        distance: (n,) m, or rad; none is left where it is negative.
        change: Change of speed that is possible from one period to the next, (n,) or one for all, m/s or rad/s.
        period: s.
    """
    reach = np.maximum(distance, 0.0) / period
    # n periods of v, v - d, ...: their sum is n v - d n (n - 1) / 2.
    n = np.maximum(np.ceil(0.5 * (np.sqrt(1.0 + 8.0 * reach / change) - 1.0)), 1.0)
    return np.asarray(reach / n + 0.5 * change * (n - 1.0))
