# SPDX-License-Identifier: MIT
"""The scene of a push as a physics model: the object's mesh, the floor, and the pusher's geometry and motion.

The physics knows bodies by their centre of mass B, captures know objects by the frame O of their mesh. Both have the
same axes. The centre of mass is that of a uniform solid, plus the `center` of `Parameters`, which is zero by default.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, get_args

import numpy as np
import torch
import trimesh
from torch import Tensor

from pinwm_drake.capture.episodes import PusherTrajectory
from pinwm_drake.capture.scene import PusherGeometry
from pinwm_drake.errors import ModelError, StateError
from pinwm_drake.geometry.floor import LYING
from pinwm_drake.geometry.meshes import load_mesh, mass_properties
from pinwm_drake.geometry.patch import FACES_POINTS, PATCH_POINTS, supporting_points
from pinwm_drake.geometry.pieces import CYLINDER, IF_LYING, ConvexPiece
from pinwm_drake.geometry.primitive import Primitive, acting_mesh, acting_pieces, acting_points
from pinwm_drake.geometry.shapes import capsule, cylinder, sphere
from pinwm_drake.geometry.stored_pieces import mesh_pieces
from pinwm_drake.physics.model import Body, Model
from pinwm_drake.physics.parameters import Parameters
from pinwm_drake.physics.state import State, Trajectory
from pinwm_drake.physics.stepper import Stepper
from pinwm_drake.spatial.poses import Pose, transform
from pinwm_drake.spatial.rotations import normalize_quaternion, quaternion_to_matrix, rotate

Support = Literal["corners", "patch", "faces"]
BODY = "object"
# Columns of `Parameters.friction` and `restitution`, in the order of `Model.pair_names`.
PAIR_FLOOR, PAIR_PUSHER = 0, 1


@dataclass(frozen=True, eq=False)
class Scene:
    """Constant part of all rollouts of one object and one pusher: physics model and mesh."""

    model: Model  # One body, the floor and the pusher; nominal mass 1 kg and the inertia of a uniform solid
    p_OB: Tensor  # (3,), centre of mass of the uniform solid in O, m
    mesh: trimesh.Trimesh  # The object, frame O, m
    acts_as: tuple[Primitive, ...] = ()  # What the physics has in its place, frame O; none for the mesh itself


def make_scene(
    mesh_path: Path,
    pusher: PusherGeometry,
    *,
    q_WO: Tensor,
    gravity: float,
    floor_height: float = 0.0,
    time_step: float = 1.0 / 240.0,
    support: Support = "patch",
    acts_as: Sequence[Primitive] = (),
) -> Scene:
    """Build the physics model of a push.

    Args:
        mesh_path: The object's mesh, m, frame O. Its parts are used where they are convex, else it is decomposed.
        pusher: The pusher's geometry, frame P.
        q_WO: (4,), wxyz: orientation of the object at rest, which tells the face that it rests on.
        gravity: m/s^2, downwards.
        floor_height: z of the floor, m.
        time_step: s.
        support: "corners" carries the object's weight on the corners of its convex pieces, "patch" on points
            within the face that it rests on, as uniform pressure does; see `geometry/patch.py`. "faces" has a third as
            many points, which takes less than two thirds of the time: objects land alike, and slide less exactly. A
            line on which a round piece lies has two points in either.
        acts_as: Primitives with which the object touches, frame O, as `stored_pieces.mesh_primitives` finds them; none
            for those of its mesh. Its mass properties stay those of the mesh.

    Returns:
        The scene.

    Raises:
        InputError: A mesh cannot be used.
        ModelError: An option is out of range.
    """
    if support not in get_args(Support):
        raise ModelError(f"support is {support!r}; allowed: 'corners', 'patch' or 'faces'")
    mesh = load_mesh(mesh_path)
    properties = mass_properties(mesh, mass=1.0)
    p_OB = properties.p_com
    touching, R_WO = acting_mesh(mesh, acts_as), quaternion_to_matrix(q_WO).numpy()
    number = {"corners": None, "patch": PATCH_POINTS, "faces": FACES_POINTS}[support]
    points = None if number is None else supporting_points(touching, R_WO, number)
    if points is not None:
        points = acting_points(points, acts_as)
        points[:, :3] -= p_OB
    pieces = acting_pieces(mesh_pieces(mesh_path), acts_as)
    pieces = [replace(piece, vertices=piece.vertices - p_OB) for piece in pieces]
    body = Body(
        name=BODY,
        pieces=pieces,
        mass=1.0,
        inertia=0.5 * (properties.inertia + properties.inertia.T),
        floor_points=points,
        even_lines=support != "corners",
    )
    model = Model(
        bodies=[body],
        pusher=_pusher_pieces(pusher),
        floor_height=floor_height,
        gravity=(0.0, 0.0, -gravity),
        time_step=time_step,
    )
    return Scene(model=model, p_OB=torch.from_numpy(p_OB), mesh=mesh, acts_as=tuple(acts_as))


def _pusher_pieces(pusher: PusherGeometry) -> list[ConvexPiece]:
    shape = pusher.shape
    if shape is None:
        if pusher.mesh_path is None:
            raise ModelError("a pusher has neither a mesh nor a shape; allowed: one of them")
        return mesh_pieces(pusher.mesh_path)
    if shape.kind == "sphere":
        return [sphere(shape.radius)]
    return [{"capsule": capsule, "cylinder": cylinder}[shape.kind](shape.radius, shape.length)]


def resting_height(scene: Scene, q_WO: Tensor) -> float:
    """Height of O [m] at which an object of orientation q_WO (4,) rests on the model's floor."""
    floor = scene.model.floor_height
    R_WO = quaternion_to_matrix(q_WO).numpy()
    table = scene.model.arrays.table
    # Those of the first body, frame B; those on an axis are of one that lies, and stand out as those of faces do.
    own = slice(table.bodies[1, 1])
    level = np.abs(table.floor_faces[own] @ R_WO[2]) < LYING
    points = table.floor_points[own][(table.floor_owners[own] != IF_LYING) | level]
    # Of a rim that is tilted the lowest point is not among those fixed on it.
    rims = [_lowest(piece, R_WO[2]) for piece in scene.model.bodies[0].pieces if piece.kind == CYLINDER]
    lowest = min(float((points[:, :3] @ R_WO[2] - points[:, 3]).min()), *rims, np.inf)
    return (0.0 if floor is None else floor) - lowest - float(R_WO[2] @ scene.p_OB.numpy())


def _lowest(cylinder: ConvexPiece, up: np.ndarray) -> float:
    """Height [m] of the lowest point of a cylinder over the origin of its frame, along the unit vector `up`."""
    axis = cylinder.vertices[1] - cylinder.vertices[0]
    sine = np.linalg.norm(np.cross(axis, up)) / np.linalg.norm(axis)
    return float((cylinder.vertices @ up).min() - cylinder.radius * sine)


def scaled_inertia(scene: Scene, mass: float, factors: Tensor) -> Tensor:
    """Inertia of an object that is not uniform: about the centre of mass, axes of O, (..., 3, 3) [kg m^2].

    The second moments of mass of the uniform solid are scaled along the axes of O: Sigma' = D Sigma D with D^2 the
    factors; the inertia is tr(Sigma') 1 - Sigma'. It is that of a body for any factors. Differentiable in them.

    Args:
        scene: Scene whose uniform solid is scaled.
        mass: kg.
        factors: (..., 3), 0 or more.
    """
    solid = torch.as_tensor(scene.model.bodies[0].inertia, dtype=torch.float64)
    one, d = torch.eye(3, dtype=torch.float64), factors.sqrt()
    sigma = mass * d[..., :, None] * (0.5 * torch.trace(solid) * one - solid) * d[..., None, :]
    return sigma.diagonal(dim1=-2, dim2=-1).sum(-1)[..., None, None] * one - sigma


def scene_parameters(values: Mapping[str, Tensor], inertia: Tensor) -> Parameters:
    """Parameters theta of W worlds; differentiable.

    Args:
        values: (W,) each: mass [kg], friction_floor and _pusher, restitution_floor and _pusher, center_x to _z [m],
            support_x to _z, and contact_offset [m].
        inertia: (W, 3, 3), about the centre of mass, kg m^2.
    """

    def stacked(*names: str) -> Tensor:
        return torch.stack([values[name] for name in names], -1)

    return Parameters(
        mass=stacked("mass"),
        inertia=inertia[:, None],
        friction=stacked("friction_floor", "friction_pusher"),
        restitution=stacked("restitution_floor", "restitution_pusher"),
        center=stacked("center_x", "center_y", "center_z")[:, None],
        spread=stacked("support_x", "support_y", "support_z")[:, None],
        offset=torch.nn.functional.pad(stacked("contact_offset"), (1, 0)),
    )


def step_count(seconds: float, time_step: float) -> int:
    """Return steps of the physics that cover a time: one or more."""
    return max(int(np.ceil(seconds / time_step - 1e-6)), 1)


@dataclass(frozen=True, eq=False)
class PusherMotion:
    """The pusher's motion in steps of the physics.

    Attributes:
        q_WP: (4,) or (W, 4), p_WP: (3,) or (W, 3), m: pose at the start.
        V_WP: (T, 6) or (T, W, 6), spatial velocity in each step, [rad/s; m/s].
    """

    q_WP: Tensor
    p_WP: Tensor
    V_WP: Tensor


def pusher_motion(trajectory: PusherTrajectory, start: float, steps: int, time_step: float) -> PusherMotion:
    """Cuts a recorded motion into steps; between its rows the pusher moves straight and turns evenly.

    Args:
        trajectory: Recorded poses; before its first and after its last row the pusher stands.
        start: Time of the first step's beginning, s.
        steps: T.
        time_step: s.

    Returns:
        The motion, which passes through the recorded line at the end of every step.
    """
    motion = pusher_motions(trajectory, np.array([start]), steps, time_step)
    return PusherMotion(motion.q_WP[0], motion.p_WP[0], motion.V_WP[:, 0])


def pusher_motions(trajectory: PusherTrajectory, starts: np.ndarray, steps: int, time_step: float) -> PusherMotion:
    """Cuts a recorded motion into steps from W times on (W,) [s]; see `pusher_motion`.

    Returns:
        The motions: q_WP (W, 4), p_WP (W, 3), V_WP (T, W, 6).
    """
    times = starts[:, None] + time_step * np.arange(steps + 1)
    p_WP = np.stack([np.interp(times, trajectory.t, trajectory.p_WP[:, axis]) for axis in range(3)], -1)
    q_WP, omega = _turns(trajectory, times, time_step)
    V_WP = np.concatenate([omega, np.diff(p_WP, axis=1) / time_step], -1).swapaxes(0, 1)
    return PusherMotion(
        torch.from_numpy(q_WP), torch.from_numpy(p_WP[:, 0].copy()), torch.from_numpy(np.ascontiguousarray(V_WP))
    )


def _turns(trajectory: PusherTrajectory, times: np.ndarray, time_step: float) -> tuple[np.ndarray, np.ndarray]:
    """Orientations (W, 4) of the pusher at first times, and angular velocities (W, T, 3) [rad/s] between times."""
    from scipy.spatial.transform import Rotation, Slerp

    W, T = times.shape
    if np.ptp(trajectory.q_WP, axis=0).max() == 0.0:
        return np.tile(trajectory.q_WP[0], (W, 1)), np.zeros((W, T - 1, 3))
    turns = Slerp(trajectory.t, Rotation.from_quat(trajectory.q_WP, scalar_first=True))
    q = turns(np.clip(times, trajectory.t[0], trajectory.t[-1]).ravel()).as_quat(scalar_first=True).reshape(W, T, 4)
    after, before = (Rotation.from_quat(part.reshape(-1, 4), scalar_first=True) for part in (q[:, 1:], q[:, :-1]))
    omega = (after * before.inv()).as_rotvec() / time_step
    return q[:, 0], omega.reshape(W, T - 1, 3)


def start_state(
    scene: Scene, parameters: Parameters, X_WO: Pose, motion: PusherMotion, V_WO: Tensor | None = None
) -> tuple[State, Tensor]:
    """State in which rollouts begin, and the pusher's velocities.

    Args:
        scene, parameters, X_WO, motion, V_WO: As for `rollout_poses`.

    Returns:
        The state of W worlds, and V_WP (T, W, 6) [rad/s; m/s].
    """
    W, p_OB = len(X_WO.p), scene.p_OB + parameters.center[:, 0]
    V_WB = torch.zeros(W, 6, dtype=torch.float64) if V_WO is None else V_WO.expand(W, 6)
    V_WB = torch.cat([V_WB[:, :3], V_WB[:, 3:] + torch.linalg.cross(V_WB[:, :3], rotate(X_WO.q, p_OB))], -1)
    start = State(
        q_WB=X_WO.q[:, None],
        p_WB=transform(X_WO, p_OB)[:, None],
        V_WB=V_WB[:, None],
        q_WP=motion.q_WP.expand(W, 4),
        p_WP=motion.p_WP.expand(W, 3),
    )
    return start, motion.V_WP if motion.V_WP.ndim == 3 else motion.V_WP[:, None].expand(-1, W, -1)


def rollout_poses(
    scene: Scene,
    parameters: Parameters,
    X_WO: Pose,
    motion: PusherMotion,
    after: Tensor,
    *,
    V_WO: Tensor | None = None,
    num_threads: int | None = None,
) -> Pose:
    """Poses of the object at given times in W worlds; differentiable in theta, the start, and the pusher's motion.

    Args:
        scene: Model and meshes.
        parameters: theta of W worlds.
        X_WO: Start: q (W, 4), p (W, 3), m.
        motion: Motion of the pusher; its tensors may have a leading axis of W where worlds differ (V_WP (T, W, 6)).
        after: (n,), times since the start, s, from 0 to T time steps.
        V_WO: Velocity at the start, (6,) or (W, 6), [rad/s; m/s] at O; None for an object at rest.
        num_threads: Threads of the physics.

    Returns:
        q_WO (n, W, 4), p_WO (n, W, 3), m: on the straight line between the two steps around each time.

    Raises:
        StateError: A time is outside the motion, or shapes do not fit.
        SolverError: The physics found no solution.
    """
    steps = len(motion.V_WP)
    at = after / scene.model.time_step
    if not bool(((at >= 0.0) & (at <= steps + 1e-6)).all()):
        last = steps * scene.model.time_step
        raise StateError(f"times of a rollout are {after.min():g} to {after.max():g} s; allowed: 0 to {last:g} s")
    start, V_WP = start_state(scene, parameters, X_WO, motion, V_WO)
    record = Stepper(scene.model, num_threads=num_threads).rollout(parameters, start, V_WP)
    return poses_at(scene, parameters, record, after)


def poses_at(scene: Scene, parameters: Parameters, record: Trajectory, after: Tensor) -> Pose:
    """Poses of the object at times `after` (n,) [s] within a recorded rollout of W worlds; see `rollout_poses`."""
    at, steps = after / scene.model.time_step, len(record.p_WB) - 1
    p_OB = scene.p_OB + parameters.center[:, 0]
    low = at.floor().long().clamp(0, max(steps - 1, 0))
    share = (at - low)[:, None, None]
    q = normalize_quaternion(torch.lerp(record.q_WB[low, :, 0], record.q_WB[low + 1, :, 0], share))
    p_WB = torch.lerp(record.p_WB[low, :, 0], record.p_WB[low + 1, :, 0], share)
    return Pose(q, p_WB - rotate(q, p_OB.expand((*q.shape[:-1], 3))))
