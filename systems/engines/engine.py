# SPDX-License-Identifier: MIT
"""Engine of a station: its ports, the contact forces that it puts out, and the means to put things into place."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from pydrake.geometry import SceneGraph
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context, InputPort, OutputPort

FLOOR_PAIR, PUSHER_PAIR = "object-floor", "object-pusher"


class Handle(Protocol):
    """Handle that puts object and pusher into place, in the context of the engine's diagram or of one around it."""

    def SetObjectState(self, context: Context, X_WO: RigidTransform, V_WO: np.ndarray, world: int = 0) -> None:
        """Set the object's pose, and its spatial velocity V_WO (6,): [ω rad/s; v m/s] at O, world frame."""

    def SetPusherPosition(self, context: Context, p_WP: np.ndarray, world: int = 0) -> None:
        """Put the pusher, at rest, to p_WP (3,) m, world."""


@dataclass(frozen=True, eq=False)
class Engine:
    """Ports of an engine inside a diagram, W worlds after one another in each vector.

    Attributes:
        name: "twin", "hydroelastic", "point" or "lcm".
        pusher_velocity: Input (3 W): v_WP [m/s], world; sampled every `Setup.period` and held.
        object_state: Output (13 W): q_WO wxyz, p_WO [m], ω_WO [rad/s], v_WO [m/s], world, at O.
        pusher_state: Output (6 W): p_WP [m], v_WP [m/s], world.
        rgb: Output, ImageRgba8U: the object of world 0 where it is visible, alpha 255; white and alpha 0 elsewhere.
        rgb_batch: Output, Value[array]: the same of all worlds, (W, height, width, 4) uint8.
        contact_forces: Output, Value[ContactForces].
        scene_graph: SceneGraph whose query output port serves Meshcat, queries and sensors.
        handle: Handle that puts things into place.
        rgb_time: Output (1): time at which `rgb` was taken, s; None where it shows the present.
        pusher_time: Output (1): time at which `pusher_state` holds, s; None where that is the present.
        fault: Output, Value[str]: fault of robot, camera or link in words; None where there is none to have.
        session: Input (1): session of the controller, 0 while it is not armed; None where nobody asks for it.
    """

    name: str
    pusher_velocity: InputPort
    object_state: OutputPort
    pusher_state: OutputPort
    rgb: OutputPort
    rgb_batch: OutputPort
    contact_forces: OutputPort
    scene_graph: SceneGraph
    handle: Handle
    rgb_time: OutputPort | None = None
    pusher_time: OutputPort | None = None
    fault: OutputPort | None = None
    session: InputPort | None = None


@dataclass(frozen=True, eq=False)
class ContactForces:
    """Contact forces on objects, n of them.

    Attributes:
        worlds: (n,) int, the world of each; 0 where there is one world only.
        pairs: n times "object-floor" or "object-pusher".
        p_WC: (n, 3) m, point of action of each, world.
        f_W: (n, 3) N, force on the object, world. In the twin they are of the time step that begins now; in Drake's
            plants, whose ports are sampled, of the last one that was made.
    """

    worlds: np.ndarray
    pairs: tuple[str, ...]
    p_WC: np.ndarray
    f_W: np.ndarray

    @staticmethod
    def none() -> "ContactForces":
        """Empty set of contact forces."""
        return ContactForces(np.zeros(0, np.int64), (), np.zeros((0, 3)), np.zeros((0, 3)))
