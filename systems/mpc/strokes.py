# SPDX-License-Identifier: MIT
"""Strokes: random sequences of actions that meet an object at some height and go on from there.

A lift by friction, a tip over an edge, a trip over the far rim and a second stroke at what lies on its side are all
such sequences. They stay in the upright plane of object and pusher, where an object turns over without a twist.
"""

import math

import numpy as np
from pydrake.common.eigen_geometry import Quaternion
from pydrake.math import RotationMatrix

from pinwm_drake.systems.envs.worlds import Worlds
from pinwm_drake.systems.scenario.start import StartDistribution
from pinwm_drake.tasks.registry import recipe_of

_STROKES = 3  # at most, after the way to the height
_GAP = 0.03  # m, largest level way to the object before the first stroke
_SHORTEST = 0.3  # of a stroke, in units of the longest translation
_RISES = (-90.0, 150.0)  # deg, of any stroke; beyond 90 it goes back
# Heights in units of the object's, rises of the first stroke and changes of the rise (mean, standard deviation) in deg.
_FAMILIES = (
    ((0.0, 0.4), (35.0, 75.0), (-15.0, 25.0)),  # lift its near side
    ((0.5, 1.1), (0.0, 50.0), (-45.0, 25.0)),  # tip or trip it over its far edge
    ((0.0, 1.1), (-10.0, 90.0), (0.0, 40.0)),  # any
)


class Strokes:
    """Draws of strokes at the object of a scene, along the heading: x from the object to the pusher, z up.

    Args:
        worlds: The worlds that carry them out, of a task for which `apply` is true.
        horizon: Number of actions of a sequence.
    """

    def __init__(self, worlds: Worlds, horizon: int) -> None:
        pusher = worlds.setup.scenario.pusher
        self._low, self._high = pusher.low[2], pusher.high[2]
        self._vertices = StartDistribution(worlds.setup).vertices
        self._horizon, self._longest = horizon, worlds.run.max_translation

    @staticmethod
    def apply(worlds: Worlds) -> bool:
        """Flag: the task moves the pusher in space, and is the same at any yaw."""
        return worlds.task.axes == ("x", "y", "z") and recipe_of(worlds.task).heading is not None

    def draw(
        self, generator: np.random.Generator, number: int, object_state: np.ndarray, p_WP: np.ndarray
    ) -> np.ndarray:
        """Actions (number, horizon, 3) in [-1, 1], of norm 1 at most, along the heading.

        Args:
            generator: Source of the draws.
            number: Number of sequences.
            object_state: (13,) q_WO wxyz, p_WO [m], ω_WO [rad/s], v_WO [m/s], world.
            p_WP: (3,) m, world: position of the pusher.
        """
        q_WO = object_state[:4] / np.linalg.norm(object_state[:4])
        heights = self._vertices @ RotationMatrix(Quaternion(wxyz=q_WO)).matrix()[2] + object_state[6]
        bottom, top = float(heights.min()), float(heights.max())
        actions = np.zeros((number, self._horizon, 3))
        for index, row in enumerate(actions):
            shares, rises, (bend, spread) = _FAMILIES[index % len(_FAMILIES)]
            height = np.clip(bottom + generator.uniform(*shares) * (top - bottom), self._low, self._high)
            way = np.array([-generator.uniform(0.0, _GAP), 0.0, height - p_WP[2]]) / self._longest
            parts = max(math.ceil(float(np.linalg.norm(way))), 1)
            row[:parts] = way / parts
            rise = generator.uniform(*rises)
            for k in range(parts, min(parts + int(generator.integers(_STROKES)) + 1, self._horizon)):
                length = generator.uniform(_SHORTEST, 1.0)
                row[k] = -length * math.cos(math.radians(rise)), 0.0, length * math.sin(math.radians(rise))
                rise = float(np.clip(rise + generator.normal(bend, spread), *_RISES))
        return actions
