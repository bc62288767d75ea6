# SPDX-License-Identifier: MIT
"""Record of an evaluation's episode, with all that is needed to show it."""

from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

from pinwm_drake.learning.evaluation import EpisodeResult


@dataclass(frozen=True, eq=False)
class EpisodeRecord:
    """Record of an episode of n actions; row k of a table is the state after k of them.

    Attributes:
        result: Outcome of the episode.
        q_WO: (n + 1, 4) wxyz, of the object.
        p_WO: (n + 1, 3) m, world.
        p_WP: (n + 1, 3) m, world, of the pusher.
        views: (m, height, width, 3) uint8, sRGB: some of the images that the policy saw; none where it sees none.
        at: (m,) int, number of actions after which it saw each.
        goal: (goal_size,) goal of the episode; of no components where all have that of the task.
        seconds: Wall time that it took.
        cpu_seconds: Time of the process's cores that it took.
    """

    result: EpisodeResult
    q_WO: np.ndarray
    p_WO: np.ndarray
    p_WP: np.ndarray
    views: np.ndarray
    at: np.ndarray
    goal: np.ndarray = field(default_factory=lambda: np.zeros(0))
    seconds: float = 0.0
    cpu_seconds: float = 0.0

    @property
    def last(self) -> int:
        """Number of the last row."""
        return len(self.p_WO) - 1

    def start(self, q_WO: tuple[float, float, float, float]) -> tuple[float, float, float]:
        """Start of the object: x [m], y [m] and its yaw [rad], a turn about z after the lying orientation q_WO."""
        turn = rotation(self.q_WO[0]) * rotation(q_WO).inv()
        a = turn.as_matrix()
        return float(self.p_WO[0, 0]), float(self.p_WO[0, 1]), float(np.arctan2(a[1, 0], a[0, 0]))


def rotation(q: object) -> Rotation:
    """Rotation of a quaternion (4,) wxyz."""
    return Rotation.from_quat(np.asarray(q, float), scalar_first=True)
