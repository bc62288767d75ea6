# SPDX-License-Identifier: MIT
"""Truth that all engines take, the scene that they make of it, and the recording that they give."""

from abc import ABC, abstractmethod
from dataclasses import dataclass, field

import numpy as np
from pydrake.common.eigen_geometry import Quaternion
from pydrake.math import RigidTransform, RotationMatrix

from pinwm_drake.capture.scene import PusherShape
from pinwm_drake.systems.pusher.motion import StraightPush
from pinwm_drake.systems.sdf.twin import twin_solid
from pinwm_drake.twin.twin import Twin

GRAVITY = 9.81  # m/s^2
FLOOR_HEIGHT = 0.0  # m
LOG_RATE = 240  # Hz, of the pusher's log


@dataclass(frozen=True, eq=False)
class Theta:
    """Truth about an object, which an engine is given.

    Attributes:
        mass: kg.
        friction_floor: Coulomb coefficient of the pair object and floor.
        friction_pusher: Coulomb coefficient of the pair object and pusher.
        p_com: (3,) m, centre of mass, frame O.
        inertia: (3, 3) kg m^2, about the centre of mass, axes of O.
        feet: (n, 3) m, frame O: points that stand out of the face below and carry the object; (0, 3) for an even face.
    """

    mass: float
    friction_floor: float
    friction_pusher: float
    p_com: np.ndarray
    inertia: np.ndarray
    feet: np.ndarray


def twin_truth(twin: Twin) -> Theta:
    """Truth as a twin has it, on an even face."""
    solid, value = twin_solid(twin), {name: one.value for name, one in twin.theta.items()}
    frictions = value["friction_floor"], value["friction_pusher"]
    return Theta(solid.mass, *frictions, solid.p_OB, solid.inertia, np.zeros((0, 3)))


@dataclass(frozen=True, eq=False)
class Rollout:
    """Recording of an engine.

    Attributes:
        t: (n,) s.
        X_WO: n poses of the object, at these times.
        p_WP: (n, 3) m, the pusher's middle, world, at these times.
    """

    t: np.ndarray
    X_WO: list[RigidTransform]
    p_WP: np.ndarray


@dataclass(frozen=True, eq=False)
class Tip:
    """A pusher.

    Attributes:
        shape: Its shape, upright.
        p_WP: (3,) m, world: where it is at first.
        axes: (n, 3) unit vectors, world: directions in which it may move, at right angles.
    """

    shape: PusherShape
    p_WP: np.ndarray
    axes: np.ndarray = field(default_factory=lambda: np.eye(3))


class EngineScene(ABC):
    """Floor, object and pusher in an engine, which go on by steps of `dt` [s].

    Made with an object, the truth about it, its pose X_WO at first, at rest, and the pusher or None.
    """

    dt: float

    @abstractmethod
    def step(self, v_WP: np.ndarray, p_WP: np.ndarray | None = None) -> None:
        """Take a step while the pusher, where there is one, has a velocity.

        Args:
            v_WP: (3,) m/s, world.
            p_WP: (3,) m, world: where the pusher begins; None for where it is. An engine may rely on velocities alone.
        """

    @property
    @abstractmethod
    def p_WP(self) -> np.ndarray:
        """Position (3,) m of the pusher, world; 0 without one."""

    @property
    @abstractmethod
    def object_state(self) -> np.ndarray:
        """State (13,): q_WO wxyz, p_WO [m], angular velocity [rad/s] and velocity of the origin [m/s], world."""

    def advance(self, v_WP: np.ndarray, seconds: float) -> None:
        """Goes on while the pusher has a velocity (3,) m/s, world."""
        for _ in range(round(seconds / self.dt)):
            self.step(v_WP)

    def roll_out(self, t: np.ndarray, motion: StraightPush | None) -> Rollout:
        """Return the recording at times (n,) s, increasing from 0, of a motion of the pusher or of none."""
        states, places, step = [], [], 0
        for time in t:
            for _ in range(round(time / self.dt) - step):
                if motion is None:
                    self.step(np.zeros(3))
                else:
                    here = motion.p_WP + motion.travel(step * self.dt)[0] * motion.direction_W
                    self.step(motion.average_velocity(step, self.dt), here)
                step += 1
            states.append(self.object_state)
            places.append(self.p_WP)
        return Rollout(np.asarray(t), [rigid(one[:4], one[4:7]) for one in states], np.array(places))


def rigid(q: np.ndarray, p: np.ndarray) -> RigidTransform:
    """Drake's pose of a quaternion (4,), wxyz, and a place (3,) [m]."""
    return RigidTransform(RotationMatrix(Quaternion(wxyz=q / np.linalg.norm(q))), p)


def log_times(frames: int, frame_rate: int) -> np.ndarray:
    """Time (n,) s of a log of `LOG_RATE` from the first of `frames` pictures to the last."""
    return np.arange((frames - 1) * (LOG_RATE // frame_rate) + 1) / LOG_RATE
