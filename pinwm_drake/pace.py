# SPDX-License-Identifier: MIT
"""Pace of long work, for the time that is left."""

import math
import time


class Pace:
    """Pace of long work after its first unit, which may hold work that is done once, as the compilation of kernels.

    Attributes:
        begun: s, `time.monotonic()` when the work began.
    """

    def __init__(self) -> None:
        self.begun = time.monotonic()
        self._from: tuple[float, float, int] | None = None
        self._counts = False

    def __call__(self, done: float, steps: int = 0) -> tuple[float, float]:
        """Return the steps a second [1/s] since the end of the first unit, and the time left [s]; NaN before the next.

        Args:
            done: Share of the work that is done, 0 to 1. The first unit ends where it first grows.
            steps: Number of steps so far.
        """
        now = time.monotonic()
        if self._from is None or (not self._counts and done > self._from[1]):
            self._counts = self._from is not None
            self._from = (now, done, steps)
        since, done_then, steps_then = self._from
        seconds, share = now - since, done - done_then
        rate = (steps - steps_then) / seconds if self._counts and steps > steps_then and seconds > 0.0 else math.nan
        left = seconds * (1.0 - done) / share if share > 0.0 else math.nan
        return rate, 0.0 if done >= 1.0 else left
