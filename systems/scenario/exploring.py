"""Starts of a training on the way to the goal, for tasks whose goal no chance action comes near."""

import numpy as np
from pydrake.common.eigen_geometry import Quaternion
from pydrake.math import RotationMatrix

from pinwm_drake.systems.scenario.setup import Setup
from pinwm_drake.systems.scenario.start import Place, StartDistribution, on_floor

_SHARES = (-0.4, 0.6)  # of the turn to the goal; below 0 is 0: farther on most objects fall to the goal by themselves
_LIFT = 2e-4  # m, of the object over the floor
_GAPS = (0.001, 0.015)  # m, from the pusher to a plane that touches the object
_ALONG = 0.02  # m, standard deviation of the pusher's place along that plane
_ATTEMPTS = 50


class ExploringStarts:
    """Distribution of places on the way from the scene's starts to the goal, the pusher anywhere beside the object.

    The object is let go on the floor, turned by any share of the way to the goal, so that it tips over or falls back.
    From near the goal what is to be done is found by chance, and from there farther and farther back.

    Source: exploring starts (Sutton and Barto, "Reinforcement learning", 5.3); from the goal backwards as in Florensa
    et al., "Reverse curriculum generation for reinforcement learning" (CoRL 2017), with all distances at once.
    """

    def __init__(self, setup: Setup) -> None:
        """Takes object, pusher, its box and the task of a scene."""
        self._start, self._task, pusher = StartDistribution(setup), setup.task, setup.scenario.pusher
        self._low, self._high = np.array(pusher.low), np.array(pusher.high)

    def draw(self, generator: np.random.Generator) -> Place:
        """Random place; one of the scene's starts where the task knows no way, or the pusher's box has no room."""
        start = self._start.draw(generator)
        q_WO = self._task.nearer(start.X_WO.rotation().ToQuaternion().wxyz(), max(generator.uniform(*_SHARES), 0.0))
        if q_WO is None:
            return start
        vertices, (x, y, _) = self._start.vertices, start.X_WO.translation()
        floor_height = self._start.floor_height + _LIFT
        X_WO = on_floor(vertices, RotationMatrix(Quaternion(wxyz=q_WO)), x, y, floor_height)
        vertices_W = vertices @ X_WO.rotation().matrix().T + X_WO.translation()
        middle = 0.5 * (vertices_W.min(0) + vertices_W.max(0))
        for _ in range(_ATTEMPTS):
            away = generator.normal(size=3)
            away /= np.linalg.norm(away)
            aside = _ALONG * generator.normal(size=3)
            aside -= away * (away @ aside)
            far = ((vertices_W - middle) @ away).max() + self._start.pusher_reach + generator.uniform(*_GAPS)
            p_WP = middle + far * away + aside
            if (p_WP >= self._low).all() and (p_WP <= self._high).all():
                return Place(X_WO, p_WP)
        return start
