# SPDX-License-Identifier: MIT
"""The model of the model-predictive controller: a rigid body that slides on a floor, pushed by a disc at one edge."""

import math
from dataclasses import dataclass

import casadi as ca
import numpy as np
from pydrake.common.eigen_geometry import Quaternion
from pydrake.math import RotationMatrix

from pinwm_drake.capture.pusher import upright_shape
from pinwm_drake.geometry.meshes import load_mesh
from pinwm_drake.geometry.patch import PATCH_POINTS, resting_points
from pinwm_drake.systems.mpc.outline import Outline, slice_outline
from pinwm_drake.systems.scenario.setup import Setup
from pinwm_drake.systems.sdf.twin import twin_solid
from pinwm_drake.tasks.push import turn_from

SUB_STEPS = 6  # steps of the model in an action
_COAST_STEPS = 8
_SPEED = 2e-3  # m/s, over which contact and slip are rounded off
_SLOW = 1e-3  # m/s, likewise where the object comes to rest


@dataclass(frozen=True, eq=False)
class PlanarBody:
    """Rigid body that slides on the floor, with everything that the model knows of a scene.

    The planar frame B is at the object's centre of mass; its axes are the world's where the object's orientation is
    `q_WO`, and turn with the object about z. A planar state (6) is x, y [m], yaw [rad], and their rates, in the world.

    Attributes:
        outline: Outline of the object at the height of the pusher, frame B.
        p_OB: (2,) m, from the origin of the mesh to the centre of mass, axes of B.
        q_WO: (4,) wxyz, orientation of the object at yaw 0.
        radius: m, radius of the pusher.
        turning: m^2, moment of inertia about z over the mass.
        lever: m, the mean distance of the floor's pressure from the centre of mass.
        friction_floor: Coulomb coefficient of object and floor.
        friction_pusher: Coulomb coefficient of object and pusher.
        gravity: m/s^2, downwards.
        horizon: s, duration of an action.
    """

    outline: Outline
    p_OB: np.ndarray
    q_WO: np.ndarray
    radius: float
    turning: float
    lever: float
    friction_floor: float
    friction_pusher: float
    gravity: float
    horizon: float

    @property
    def braking(self) -> float:
        """Deceleration of a sliding object, m/s^2."""
        return self.friction_floor * self.gravity

    def planar(self, object_state: np.ndarray) -> np.ndarray:
        """Planar state (6) of an object's state (13,): q_WO wxyz, p_WO [m], ω_WO [rad/s], v_WO [m/s], world."""
        yaw = float(turn_from(self.q_WO, object_state[:4]))
        offset = rotated(self.p_OB, yaw)
        turn = float(object_state[9])
        v = object_state[10:12] + turn * np.array([-offset[1], offset[0]])
        return np.array([*(object_state[4:6] + offset), math.remainder(yaw, 2 * math.pi), *v, turn])


def planar_body(setup: Setup) -> PlanarBody:
    """Planar body of a scene, from theta of its twin, and the shapes of object and pusher.

    Args:
        setup: The scene, as `environment_setup` makes it; the object's orientation is `scenario.start.q_WO`.

    Raises:
        InputError: A mesh cannot be used.
        ParameterError: The pusher's height is not within the object.
    """
    twin, start = setup.twin, setup.scenario.start
    q_WO = np.array(start.q_WO) / np.linalg.norm(start.q_WO)
    R_WO = RotationMatrix(Quaternion(wxyz=q_WO)).matrix()
    mesh, solid = load_mesh(twin.mesh_path), twin_solid(twin)
    points = resting_points(mesh, R_WO)
    lying = mesh.copy()
    lying.apply_transform(np.block([[R_WO, np.zeros((3, 1))], [np.zeros((1, 3)), np.ones((1, 1))]]))
    p_OB = R_WO @ solid.p_OB
    height = start.pusher_height - twin.floor_height + float(lying.bounds[0, 2])
    outline = slice_outline(lying, height)
    face = (outline.corners if points is None else points[:PATCH_POINTS] @ R_WO[:2].T) - p_OB[:2]
    inertia = float(R_WO[2] @ solid.inertia @ R_WO[2])
    return PlanarBody(
        outline=Outline(outline.corners - p_OB[:2]),
        p_OB=p_OB[:2],
        q_WO=q_WO,
        radius=float(upright_shape(twin.pusher).radius),
        turning=inertia / solid.mass,
        lever=float(np.hypot(*face.T).mean()),
        friction_floor=twin.theta["friction_floor"].value,
        friction_pusher=twin.theta["friction_pusher"].value,
        gravity=twin.gravity,
        horizon=setup.scenario.pusher.horizon,
    )


def rotated(vector: np.ndarray, yaw: float | np.ndarray) -> np.ndarray:
    """Vectors (..., 2) turned by an angle [rad], or (n, 2) by an angle (n,) each."""
    c, s = np.cos(yaw), np.sin(yaw)
    return np.stack([c * vector[..., 0] - s * vector[..., 1], s * vector[..., 0] + c * vector[..., 1]], axis=-1)


def push_step(body: PlanarBody, x: ca.SX, p: ca.SX, v: ca.SX, edge: ca.SX) -> tuple[ca.SX, ca.SX]:
    """One sub-step of an action, of which there are `SUB_STEPS`.

    Floor friction is that of an ellipsoidal limit surface; then the contact with the pusher takes the impulse, per
    mass, after which they do not approach farther than their gap, an LCP of one contact, solved in closed form. Corners
    of functions are rounded off, so that there are derivatives. Last, the state moves on with the new velocity.

    Args:
        body: The model of the scene.
        x: (6) planar state.
        p: (2) m, world: position of the pusher.
        v: (2) m/s, world: velocity of the pusher.
        edge: (4) a point of the edge [m] and its outward normal, frame B. The edge is a whole line here.

    Returns:
        Planar state (6) and position of the pusher (2), a sub-step later.

    Source: for the limit surface, Howe and Cutkosky, IJRR 15(6), 1996.
    """
    h = body.horizon / SUB_STEPS
    c, s = ca.cos(x[2]), ca.sin(x[2])
    n = ca.vertcat(c * edge[2] - s * edge[3], s * edge[2] + c * edge[3])
    t = ca.vertcat(-n[1], n[0])
    away = p - x[:2]
    gap = ca.dot(n, away) - (edge[2] * edge[0] + edge[3] * edge[1]) - body.radius
    velocity = _braked(body, x[3:], h, 1.2 * h * body.braking)
    r = away - (body.radius + gap) * n
    arm_n, arm_t = r[0] * n[1] - r[1] * n[0], r[0] * t[1] - r[1] * t[0]
    W_n, W_t = 1.0 + arm_n**2 / body.turning, 1.0 + arm_t**2 / body.turning
    slip = v - velocity[:2] - velocity[2] * ca.vertcat(-r[1], r[0])
    # Speed at which they would come too near; the object is pushed along -n.
    excess = -(gap / h + ca.dot(n, slip))
    push = 0.5 * (excess + ca.sqrt(excess**2 + _SPEED**2)) / W_n
    drag = ca.dot(t, slip)
    most = body.friction_pusher * push
    rub = drag * most / ca.sqrt(drag**2 + (most * W_t) ** 2 + 1e-12)
    impulse = -push * n + rub * t
    turn = (-push * arm_n + rub * arm_t) / body.turning
    velocity = velocity + ca.vertcat(impulse, turn)
    return ca.vertcat(x[:3] + h * velocity, velocity), p + h * v


def coast(body: PlanarBody, x: ca.SX) -> ca.SX:
    """Pose of B (3) in which an object comes to rest that nothing pushes any more, from its planar state (6).

    Translation and rotation stop together, after about the time that the friction takes; the steps are equal parts of
    that time.
    """
    v, h = x[3:], coasting_time(body, x) / _COAST_STEPS
    pose = x[:3]
    for _ in range(_COAST_STEPS):
        middle = _braked(body, v, 0.5 * h, _SLOW)
        pose = pose + h * middle
        v = v + h * (_braked(body, middle, 1.0, _SLOW) - middle)
    return pose


def coasting_time(body: PlanarBody, x: ca.SX) -> ca.SX:
    """Time [s] for which an object in a planar state (6) goes on sliding."""
    line, turn = x[3] ** 2 + x[4] ** 2 + _SLOW**2, (body.lever * x[5]) ** 2
    braking = body.braking * (line + body.lever**2 / body.turning * turn) / (line + turn)
    return ca.sqrt(line + turn) / braking


def _braked(body: PlanarBody, v: ca.SX, h: ca.SX | float, rounding: float) -> ca.SX:
    """Velocities (3) after friction with the floor for a time h [s]; slower than `rounding` [m/s] it grows weaker."""
    speed = ca.sqrt(v[0] ** 2 + v[1] ** 2 + (body.lever * v[2]) ** 2 + rounding**2)
    share = h * body.braking / speed
    return ca.vertcat(v[0] * (1 - share), v[1] * (1 - share), v[2] * (1 - share * body.lever**2 / body.turning))
