# SPDX-License-Identifier: MIT
"""The time step of a twin, from its fastest push."""

import math
from collections.abc import Sequence

import numpy as np

from pinwm_drake.capture.episodes import Episode

LONGEST, MOST_WAY = 1.0 / 240.0, 5e-3  # s; m, of the pusher in a step


def way_in_a_step(pushes: Sequence[Episode], time_step: float) -> float:
    """Farthest way, m, by which the pusher moves within a step [s], while any of the pushes is seen."""
    ways = [0.0]
    for push in pushes:
        t, p, seen = push.trajectory.t, push.trajectory.p_WP, push.times
        times = np.arange(max(t[0], seen.min()), min(t[-1], seen.max()) + time_step, time_step)
        moved = np.diff([np.interp(times, t, p[:, axis]) for axis in range(3)], axis=1)
        ways.append(float(np.linalg.norm(moved, axis=0).max(initial=0.0)))
    return max(ways)


def time_step_of(pushes: Sequence[Episode]) -> float:
    """Longest of 1/240 s and its halves, quarters and so on in which the pusher moves by MOST_WAY at most, s."""
    halvings = math.log2(max(way_in_a_step(pushes, LONGEST) / MOST_WAY, 1.0))
    return LONGEST / 2 ** math.ceil(halvings - 1e-9)
