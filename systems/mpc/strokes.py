# SPDX-License-Identifier: MIT
"""Strokes: random sequences of actions that meet an object at some height and go on from there.

A lift by friction, a tip over an edge, a trip over the far rim and a second stroke at what lies on its side are all
such sequences. They stay in the upright plane of object and pusher, where an object turns over without a twist.
"""

import math

import numpy as np
from pydrake.common.eigen_geometry import Quaternion
from pydrake.math import RotationMatrix

from pinwm_drake.capture.pusher import upright_shape
from pinwm_drake.systems.envs.worlds import Worlds
from pinwm_drake.systems.scenario.start import StartDistribution
from pinwm_drake.tasks.registry import recipe_of

_STROKES = 3  # at most, after the way to where the first one begins
_RUN_UP = (-0.01, 0.03)  # m, from where the first stroke begins to the face that it meets
_BACK = 0.03  # m, farthest way back from the object before the first stroke
_GATHERED = 2  # actions towards the object, at most, in which a pusher of limited acceleration gathers speed
_FIRST, _SHORTEST = 0.7, 0.3  # least length of the first stroke and of others, in units of the longest translation
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
        self._radius = upright_shape(worlds.setup.twin.pusher).radius
        self._horizon, self._longest = horizon, worlds.run.max_translation
        # Most change of an action's translation from one to the next, in units of the longest one.
        self._change = worlds.acceleration * pusher.horizon**2 / self._longest

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
        points = self._vertices @ RotationMatrix(Quaternion(wxyz=q_WO)).matrix().T
        bottom, top = (float(end + object_state[6]) for end in (points[:, 2].min(), points[:, 2].max()))
        away = (p_WP - object_state[4:7])[:2]
        distance = float(np.linalg.norm(away))
        face = float((points[:, :2] @ away).max()) / distance if distance > 0.0 else 0.0
        gap = distance - face - self._radius
        actions = np.zeros((number, self._horizon, 3))
        for index, row in enumerate(actions):
            shares, rises, (bend, spread) = _FAMILIES[index % len(_FAMILIES)]
            height = np.clip(bottom + generator.uniform(*shares) * (top - bottom), self._low, self._high)
            level = max(gap - generator.uniform(*_RUN_UP), -_BACK)
            gathered = int(generator.integers(_GATHERED + 1)) if math.isfinite(self._change) else 0
            if gathered:
                level -= self._longest * self.gathered(gathered)
            way = np.array([-level, 0.0, height - p_WP[2]]) / self._longest
            parts = max(math.ceil(float(np.linalg.norm(way))), 1)
            row[:parts] = way / parts
            if gathered:
                parts += 1  # it comes to rest
                row[parts : parts + gathered, 0] = -1.0
                parts += gathered
            rise = generator.uniform(*rises)
            for k in range(parts, min(parts + int(generator.integers(_STROKES)) + 1, self._horizon)):
                length = generator.uniform(_FIRST if k == parts else _SHORTEST, 1.0)
                row[k] = -length * math.cos(math.radians(rise)), 0.0, length * math.sin(math.radians(rise))
                rise = float(np.clip(rise + generator.normal(bend, spread), *_RISES))
        return actions

    def gathered(self, number: int) -> float:
        """Return the way from rest, in units of the longest translation, in a number of actions at full speed."""
        rising = min(1.0 / self._change, number)  # actions in which the speed rises
        return 0.5 * self._change * rising**2 + number - rising
