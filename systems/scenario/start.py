# SPDX-License-Identifier: MIT
"""Random places of object and pusher at the start of an episode."""

import dataclasses
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import chain, product, repeat

import numpy as np
from pydrake.common.eigen_geometry import AngleAxis, Quaternion
from pydrake.math import RigidTransform, RotationMatrix

from pinwm_drake.capture.pusher import pushing_height, upright_shape
from pinwm_drake.geometry.meshes import load_mesh, mass_properties
from pinwm_drake.systems.scenario.schema import Start
from pinwm_drake.systems.scenario.setup import Setup

_STRAY, _GAP = 0.12, 0.15  # m, of a further try
_ABOVE, _OVER = 0.01, 0.4  # m, from the top to a pusher over the object at least; share of such places
_LEVEL = 0.7  # least level part of the direction from a lying object to its pusher, of unit length


@dataclass(frozen=True, eq=False)
class Place:
    """Places of object and pusher, both at rest.

    Attributes:
        X_WO: Pose of the object, on the floor.
        p_WP: (3,) m, world: position of the pusher.
    """

    X_WO: RigidTransform
    p_WP: np.ndarray

    @property
    def object_state(self) -> np.ndarray:
        """State (13,) of the object at rest there: q_WO wxyz, p_WO [m], then zeros for ω_WO and v_WO."""
        return np.array([*self.X_WO.rotation().ToQuaternion().wxyz(), *self.X_WO.translation(), *np.zeros(6)])


class StartDistribution:
    """Distribution of starts that `Scenario.start` describes, for the object and the pusher of a setup.

    Attributes:
        vertices: (n, 3) m, frame O: vertices of the object.
    """

    def __init__(self, setup: Setup) -> None:
        self._start = setup.scenario.start
        self._floor_height = setup.twin.floor_height
        self._low, self._high = setup.scenario.pusher.low, setup.scenario.pusher.high
        self.vertices = load_mesh(setup.twin.mesh_path).vertices
        self._reach = upright_shape(setup.twin.pusher).radius
        q_WO = np.array(self._start.q_WO)
        self._R = RotationMatrix(Quaternion(wxyz=q_WO / np.linalg.norm(q_WO)))
        self._roll_axis = np.array(self._start.roll_axis) / max(float(np.linalg.norm(self._start.roll_axis)), 1e-300)

    def middle(self) -> Place:
        """Place at the middle of every range, without a roll."""
        return self._place(self._start, lambda ends: 0.5 * (ends[0] + ends[1]))

    def extremes(self) -> list[Place]:
        """Places at the ends of the ranges of x, y and yaw, and at the middle of yaw."""
        places = []
        for shares in product((0.0, 1.0), (0.0, 1.0), (0.0, 0.5, 1.0)):
            left = chain(shares, repeat(0.5))

            def pick(ends: list[float], left: Iterator[float] = left) -> float:
                return ends[0] + next(left) * (ends[1] - ends[0])

            places.append(self._place(self._start, pick))
        return places

    def draw(self, generator: np.random.Generator) -> Place:
        """Random place, each number drawn evenly from its range."""
        return self._drawn(self._start, generator)

    def anywhere(self, generator: np.random.Generator) -> tuple[Place, np.ndarray]:
        """Random place of a further try: the object where others have left it, the pusher on any side of it.

        The object is up to 0.12 m outside the ranges of x and y, at any yaw; the gap is up to 0.15 m, and the pusher is
        between its height at the start and the top of its box. In four of ten places it is over the object, where a
        lift that failed leaves it, or beside it at such a height.

        Returns:
            The place, and the position (3,) m, world, of a pusher that begins there as the scene says.
        """
        start = self._start
        x, y = ([min(ends) - _STRAY, max(ends) + _STRAY] for ends in (start.x, start.y))
        begun = self._drawn(dataclasses.replace(start, x=x, y=y, yaw=[-math.pi, math.pi]), generator)
        angle, height = generator.uniform(-math.pi, math.pi), generator.uniform(start.pusher_height, self._high[2])
        radius, top = self.clear_of(begun.X_WO)
        distance = radius + generator.uniform(min(start.pusher_gap), _GAP)
        if top < self._high[2] and generator.uniform() < _OVER:
            height, distance = generator.uniform(top, min(self._high[2], top + _GAP)), radius * generator.uniform()
        away = [distance * math.cos(angle), distance * math.sin(angle)]
        p_WP = np.clip([*begun.X_WO.translation()[:2] + away, height], self._low, self._high)
        return Place(begun.X_WO, p_WP), begun.p_WP

    def beside(self, X_WO: RigidTransform) -> np.ndarray | None:
        """Position (3,) m, world, of a pusher that begins a further try at an object that lies in some pose.

        It is on the side of the object on which the scene has it, in the middle of the ranges; None where that side
        points up or down.
        """
        start = self._start
        angle, gap = (0.5 * sum(ends) for ends in (start.pusher_angle, start.pusher_gap))
        away = np.array([math.cos(angle), math.sin(angle), 0.0])
        if start.pusher_from == "object":
            away = X_WO.rotation().matrix() @ self._R.matrix().T @ away
        level = math.hypot(*away[:2])
        if level < _LEVEL:
            return None
        distance = self._radius(X_WO.rotation()) + gap
        p_WP = np.array([*X_WO.translation()[:2] + distance * away[:2] / level, start.pusher_height])
        return np.clip(p_WP, self._low, self._high)

    def clear_of(self, X_WO: RigidTransform) -> tuple[float, float]:
        """Level distance from the origin of an object [m], and height [m, world]: a pusher beyond either is free."""
        top = (self.vertices @ X_WO.rotation().matrix()[2]).max() + X_WO.translation()[2]
        return self._radius(X_WO.rotation()), float(top) + self._reach + _ABOVE

    def _drawn(self, start: Start, generator: np.random.Generator) -> Place:
        roll = int(generator.integers(start.rolls)) if start.rolls > 1 else 0
        turn = 2.0 * math.pi * roll / start.rolls
        return self._place(start, lambda ends: float(generator.uniform(ends[0], ends[1])), turn)

    def _place(self, start: Start, pick: Callable[[list[float]], float], roll: float = 0.0) -> Place:
        ranges = (start.x, start.y, start.yaw, start.pusher_angle, start.pusher_gap)
        x, y, yaw, angle, gap = (pick(ends) for ends in ranges)
        R_WO = RotationMatrix.MakeZRotation(yaw) @ self._R
        if roll:
            R_WO = R_WO @ RotationMatrix(AngleAxis(roll, self._roll_axis))
        angle += yaw if start.pusher_from == "object" else 0.0
        X_WO = on_floor(self.vertices, R_WO, x, y, self._floor_height)
        distance = self._radius(R_WO) + gap
        p_WP = [x + distance * math.cos(angle), y + distance * math.sin(angle), start.pusher_height]
        return Place(X_WO, np.array(p_WP))

    def _radius(self, R_WO: RotationMatrix) -> float:
        """Level distance [m] of the pusher from the object's origin at which they may touch."""
        return float(np.linalg.norm(self.vertices @ R_WO.matrix()[:2].T, axis=1).max()) + self._reach


def on_floor(vertices: np.ndarray, R_WO: RotationMatrix, x: float, y: float, floor_height: float) -> RigidTransform:
    """Pose X_WO of an object that touches the floor.

    Args:
        vertices: (n, 3) m, frame O: points of the object.
        R_WO: Orientation of the object.
        x: m, world: x of its origin O.
        y: m, world: y of O.
        floor_height: m, world: z of the floor.
    """
    return RigidTransform(R_WO, [x, y, floor_height - (vertices @ R_WO.matrix()[2]).min()])


def level_height(setup: Setup) -> float:
    """Height z of a pusher [m, world] that pushes at the height of the centre of mass, or as near as the floor allows.

    Args:
        setup: The scene; its object has the orientation `scenario.start.q_WO`.

    Raises:
        InputError: A mesh cannot be used.
    """
    mesh, shape = load_mesh(setup.twin.mesh_path), upright_shape(setup.twin.pusher)
    p_OB_z = (StartDistribution(setup).middle().X_WO @ mass_properties(mesh, mass=1.0).p_com)[2]
    return pushing_height(shape, setup.twin.floor_height, float(p_OB_z))


def with_start_yaw(setup: Setup, yaw: float, goal_yaw: float | None = None) -> Setup:
    """Return the scene whose object is turned at the start by `yaw` [rad] from the goal at most, either way.

    Args:
        setup: The scene.
        yaw: rad, largest turn from the goal, 0 or more.
        goal_yaw: rad, yaw of the goal; None for that of the scene's task.
    """
    middle = setup.task.goal_yaw if goal_yaw is None else goal_yaw
    start = dataclasses.replace(setup.scenario.start, yaw=[middle - yaw, middle + yaw])
    return dataclasses.replace(setup, scenario=dataclasses.replace(setup.scenario, start=start))
