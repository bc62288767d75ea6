# SPDX-License-Identifier: MIT
"""The criterion for an object that a scripted push has moved to be at rest."""

from dataclasses import dataclass

import numpy as np

REST_SPEED = 1e-3  # m/s: from there an object slides on by v^2 / 2 mu g, 2 um at mu 0.03
REST_TURN = 0.01  # rad/s
REST_TIME = 0.1  # s, for which it has to be as slow


def is_slow(object_state: np.ndarray) -> np.ndarray:
    """Flag: the object's origin O, and its turning, are slower than the thresholds.

    Args:
        object_state: (..., 13), as the station's port has it.

    Returns:
        (...) bool.
    """
    speed, turn = (np.linalg.norm(object_state[..., part], axis=-1) for part in (np.s_[10:13], np.s_[7:10]))
    return np.asarray((speed < REST_SPEED) & (turn < REST_TURN))


@dataclass
class RestCount:
    """Samples in a row in which an object was slow, up to those that make it count as at rest.

    An `Episode` asks O and the turning (`is_slow`), in samples that span `REST_TIME`; the cross-check asks the fastest
    point of the object, in as many samples as `REST_TIME` has periods, which is one less. A task's success is
    stricter in one way and laxer in another: it has thresholds of its own, and asks a single moment (`tasks/push.py`).

    Attributes:
        needed: Samples.
        slow: Samples in a row so far.
    """

    needed: int
    slow: int = 0

    @property
    def at_rest(self) -> bool:
        """Flag: as many slow samples have come as it takes."""
        return self.slow >= self.needed

    def add(self, slow: bool) -> bool:
        """Count a sample; a fast one begins anew. Returns whether the object is at rest."""
        self.slow = self.slow + 1 if slow else 0
        return self.at_rest
