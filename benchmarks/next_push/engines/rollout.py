"""Truth that all engines take, and the recording that they give: where object and pusher have been."""

from dataclasses import dataclass

import numpy as np
from pydrake.common.eigen_geometry import Quaternion
from pydrake.math import RigidTransform, RotationMatrix

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


def rigid(q: np.ndarray, p: np.ndarray) -> RigidTransform:
    """Drake's pose of a quaternion (4,), wxyz, and a place (3,) [m]."""
    return RigidTransform(RotationMatrix(Quaternion(wxyz=q / np.linalg.norm(q))), p)


def log_times(frames: int, frame_rate: int) -> np.ndarray:
    """Times (n,) s of a log of `LOG_RATE` from the first of `frames` pictures to the last."""
    return np.arange((frames - 1) * (LOG_RATE // frame_rate) + 1) / LOG_RATE
