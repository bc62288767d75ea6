"""Draws where object and pusher are at first."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from pinwm_drake.systems.push_choice import upright_shape
from pinwm_drake.systems.setup import Setup
from pydrake.common.eigen_geometry import Quaternion
from pydrake.math import RigidTransform, RotationMatrix

from pinwm_drake.geometry.meshes import load_mesh


@dataclass(frozen=True, eq=False)
class Place:
    """Where object and pusher are, both at rest.

    Attributes:
        X_WO: Pose of the object, on the floor.
        p_WP: (3,) m, of the pusher.
    """

    X_WO: RigidTransform
    p_WP: np.ndarray


class StartDistribution:
    """What `Scenario.start` describes, for the object and the pusher of a setup."""

    def __init__(self, setup: Setup) -> None:
        """Measures object and pusher."""
        self._start = setup.scenario.start
        self._floor = setup.twin.floor_height
        self._vertices = load_mesh(setup.twin.mesh_path).vertices
        self._pusher_reach = upright_shape(setup.twin.pusher).radius
        q_WO = np.array(self._start.q_WO)
        self._R = RotationMatrix(Quaternion(wxyz=q_WO / np.linalg.norm(q_WO)))

    def middle(self) -> Place:
        """The middle of every range."""
        return self._place(lambda ends: 0.5 * (ends[0] + ends[1]))

    def draw(self, generator: np.random.Generator) -> Place:
        """A place, each number drawn evenly from its range."""
        return self._place(lambda ends: float(generator.uniform(ends[0], ends[1])))

    def _place(self, pick: Callable[[list[float]], float]) -> Place:
        start = self._start
        ranges = (start.x, start.y, start.yaw, start.pusher_angle, start.pusher_gap)
        x, y, yaw, angle, gap = (pick(ends) for ends in ranges)
        R_WO = RotationMatrix.MakeZRotation(yaw) @ self._R
        turned = self._vertices @ R_WO.matrix().T
        p_WO = np.array([x, y, self._floor - turned[:, 2].min()])
        distance = np.linalg.norm(turned[:, :2], axis=1).max() + gap + self._pusher_reach
        along = np.array([math.cos(angle), math.sin(angle)])
        return Place(RigidTransform(R_WO, p_WO), np.array([*(p_WO[:2] + distance * along), start.pusher_height]))
