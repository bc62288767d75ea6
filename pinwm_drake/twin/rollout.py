# SPDX-License-Identifier: MIT
"""Prediction by a twin: its physics along a pusher's motion."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import torch

from pinwm_drake.capture.episodes import ObjectPoses, PusherTrajectory
from pinwm_drake.capture.pusher import upright_shape
from pinwm_drake.errors import SolverError
from pinwm_drake.geometry.meshes import load_mesh
from pinwm_drake.physics.impulses import contact_impulses
from pinwm_drake.physics.model import Model
from pinwm_drake.physics.parameters import Parameters
from pinwm_drake.physics.state import State
from pinwm_drake.physics.stepper import Stepper
from pinwm_drake.scene import (
    PAIR_PUSHER,
    PusherMotion,
    Scene,
    make_scene,
    pusher_motion,
    resting_height,
    rollout_poses,
    scaled_inertia,
    scene_parameters,
    start_state,
    step_count,
)
from pinwm_drake.spatial.poses import Pose, transform
from pinwm_drake.spatial.rotations import rotate
from pinwm_drake.twin.drift import grips
from pinwm_drake.twin.frame import drawn_frames, moved_motion, pivot_of
from pinwm_drake.twin.kicks import Kicks, carried_kicks
from pinwm_drake.twin.twin import Twin

# An object that starts this near to the floor [m] rests on it; one that is farther up falls.
_RESTS = 5e-3
# Where the contacts of a step have no solution that the solvers find, smaller steps meet others.
_HALVINGS = 4
_GAP = 5e-3  # m, between pusher and the box around the object at the start of `twin_physics`
# Factors of the spread of the pressure on a face or line.
SUPPORT = ("support_x", "support_y", "support_z")
# Nuisances that have a part in the physics, and their values without effect.
NO_EFFECT = {f"center_{axis}": 0.0 for axis in "xyz"} | dict.fromkeys(SUPPORT, 1.0)
NO_EFFECT |= {"contact_offset": 0.0}


def twin_scene(twin: Twin, q_WO: torch.Tensor) -> Scene:
    """Return the physics of a twin that starts in an orientation q_WO (4,); raise InputError for a bad mesh."""
    return make_scene(
        twin.mesh_path,
        twin.pusher,
        q_WO=q_WO,
        gravity=twin.gravity,
        floor_height=twin.floor_height,
        time_step=twin.time_step,
        support=twin.support,
        acts_as=twin.acts_as,
    )


def twin_parameters(twin: Twin, scene: Scene) -> Parameters:
    """Parameters of one world. Products of inertia are those of the mesh, scaled like the moments."""
    estimates = twin.theta | twin.nuisance
    return _physical_parameters({name: [estimate.value] for name, estimate in estimates.items()}, scene)


def drawn_parameters(twin: Twin, scene: Scene, rows: np.ndarray, *, anew: bool = True) -> Parameters:
    """Parameters of W worlds by rows (W,) of the draws of a twin; the same W times without draws.

    With `anew`, each world has the frictions of a push that was not seen, see `drift.grips`.
    """
    known = {name: [estimate.value] * len(rows) for name, estimate in (twin.theta | twin.nuisance).items()}
    drawn = {} if twin.draws is None else {name: twin.draws.column(name)[rows].tolist() for name in twin.draws.names}
    for name, factor in grips(rows).items():
        if anew and name in drawn:
            drawn[name] = (np.asarray(drawn[name]) * factor).tolist()
    return _physical_parameters(known | drawn, scene)


def _physical_parameters(values: Mapping[str, Sequence[float]], scene: Scene) -> Parameters:
    """Parameters of W worlds by W values for each of `THETA` and the nuisances; a missing one has no effect."""
    theta = {name: [plain] * len(values["mass"]) for name, plain in NO_EFFECT.items()} | dict(values)
    tensors = {name: torch.tensor(value, dtype=torch.float64) for name, value in theta.items()}
    solid = torch.as_tensor(scene.model.bodies[0].inertia, dtype=torch.float64).diagonal()
    moments = torch.stack([tensors[f"inertia_{2 * axis}"] for axis in "xyz"], -1)
    # Second moments of mass along the axes: they scale independently, moments of inertia do not.
    second, wanted = (0.5 * diagonal.sum(-1, keepdim=True) - diagonal for diagonal in (solid, moments))
    factors = wanted.clamp_min(0.0) / second.clamp_min(1e-300)
    return scene_parameters(tensors, scaled_inertia(scene, 1.0, factors))


def rollout(
    twin: Twin, X_WO: Pose, trajectory: PusherTrajectory, t: np.ndarray, V_WO: torch.Tensor | None = None
) -> ObjectPoses:
    """Poses of the object along a motion of the pusher.

    Args:
        twin: Geometry and theta.
        X_WO: Pose at t[0]; q (4,), p (3,) [m]. Near the floor, it is put on it.
        trajectory: Motion of the pusher in the world of the object; see `frame.in_world`.
        t: (n,) [s], not decreasing.
        V_WO: Velocity at t[0], (6,) [rad/s; m/s] at O; None for an object at rest.

    Returns:
        The poses at t.

    Raises:
        InputError: A mesh cannot be used.
        SolverError: The physics found no solution, at the twin's time step nor at smaller ones.
    """
    t = np.asarray(t, float)
    for halving in range(_HALVINGS):
        try:
            scene = twin_scene(replace(twin, time_step=twin.time_step / 2**halving), X_WO.q)
            found = rollout_worlds(scene, twin_parameters(twin, scene), X_WO, trajectory, t, V_WO=V_WO)
            return ObjectPoses(t=t, p_WO=found.p[:, 0].numpy(), q_WO=found.q[:, 0].numpy())
        except SolverError as error:
            failure = error
    raise failure


def rollout_draws(
    twin: Twin,
    X_WO: Pose,
    trajectory: PusherTrajectory,
    t: np.ndarray,
    rows: np.ndarray,
    V_WO: torch.Tensor | None = None,
) -> Pose:
    """Poses q (n, W, 4), p (n, W, 3) [m] as of `rollout`, by rows (W,) of the draws of a twin, at its time step only.

    The motion is that of the robot's log, which the frame of each draw moves. Without draws, all W are the same.
    """
    scene, frames = twin_scene(twin, X_WO.q), (drawn_frames(twin, rows), pivot_of(twin))
    parameters, t = drawn_parameters(twin, scene, rows), np.asarray(t, float)
    return rollout_worlds(scene, parameters, X_WO, trajectory, t, frames, V_WO)


def rollout_worlds(
    scene: Scene,
    parameters: Parameters,
    X_WO: Pose,
    trajectory: PusherTrajectory,
    t: np.ndarray,
    frames: tuple[torch.Tensor, torch.Tensor] | None = None,
    V_WO: torch.Tensor | None = None,
) -> Pose:
    """Poses q (n, W, 4), p (n, W, 3) [m] of W worlds that start alike; see `rollout`.

    Frames (W, 3) move the pusher's motion about a pivot (3,) [m] in each world; see `frame.py`.

    Raises:
        SolverError: The physics found no solution.
    """
    start, motion = _begin(scene, X_WO, trajectory, t, parameters.num_worlds)
    motion = motion if frames is None else moved_motion(motion, *frames)
    with torch.no_grad():
        return rollout_poses(scene, parameters, start, motion, torch.from_numpy(t - t[0]), V_WO=V_WO)


def rollout_kicks(
    scene: Scene,
    parameters: Parameters,
    X_WO: Pose,
    trajectory: PusherTrajectory,
    t: np.ndarray,
    V_WO: torch.Tensor | None = None,
) -> Kicks:
    """Deviations of the poses of one world of `rollout_worlds` by errors of velocities; see `kicks.py`."""
    start, motion = _begin(scene, X_WO, trajectory, t, 1)
    return carried_kicks(scene, parameters, start, motion, torch.from_numpy(np.asarray(t, float) - t[0]), V_WO=V_WO)


def _begin(
    scene: Scene, X_WO: Pose, trajectory: PusherTrajectory, t: np.ndarray, num_worlds: int
) -> tuple[Pose, PusherMotion]:
    """Poses of W worlds in which rollouts at times t (n,) [s] begin, and the pusher's motion."""
    start, h = resting_start(scene, X_WO), scene.model.time_step
    motion = pusher_motion(trajectory, float(t[0]), step_count(t[-1] - t[0], h), h)
    return Pose(start.q.expand(num_worlds, 4), start.p.expand(num_worlds, 3)), motion


def resting_start(scene: Scene, X_WO: Pose) -> Pose:
    """Pose in which a rollout begins: X_WO, q (4,), p (3,) [m], put on the floor where it is near to it."""
    rest = resting_height(scene, X_WO.q)
    p_WO = X_WO.p.clone()
    if abs(float(p_WO[2]) - rest) < _RESTS:
        p_WO[2] = rest
    return Pose(X_WO.q, p_WO)


def pusher_impulses(
    scene: Scene, parameters: Parameters, X_WO: Pose, motion: PusherMotion, *, num_threads: int | None = None
) -> np.ndarray:
    """Impulses (T, W, 3) N s of the object on the pusher in every step of W rollouts, world axes.

    Arguments and errors are those of `scene.rollout_poses`.
    """
    start, V_WP = start_state(scene, parameters, X_WO, motion)
    with torch.no_grad():
        record = Stepper(scene.model, num_threads=num_threads).rollout(parameters, start, V_WP)
    on_object = contact_impulses(scene.model, parameters, record, V_WP, num_threads=num_threads)
    return -on_object[:, :, PAIR_PUSHER]


class TwinPhysics(NamedTuple):
    """Physics of a twin in one world, for `Stepper`.

    Attributes:
        model: Bodies, pusher, floor and time step.
        parameters: Mass, inertia, frictions and the like, of the twin's estimates.
        start: State in which the object rests on the floor at the world's origin; the pusher is beside it on -x.
    """

    model: Model
    parameters: Parameters
    start: State


def twin_physics(twin: Twin, q_WO: Sequence[float] = (1.0, 0.0, 0.0, 0.0)) -> TwinPhysics:
    """Physics of a twin whose object rests on the floor.

    Args:
        twin: The twin.
        q_WO: (4,) wxyz, orientation of the object at the start.

    Returns:
        Model, parameters and start; all tensors are leaves, so that any may ask for a gradient.

    Raises:
        InputError: A mesh cannot be used.
    """
    q = torch.tensor(q_WO, dtype=torch.float64)
    scene = twin_scene(twin, q)
    parameters = twin_parameters(twin, scene)
    X_WO = Pose(q[None], torch.tensor([[0.0, 0.0, resting_height(scene, q)]], dtype=torch.float64))
    p_WB = transform(X_WO, scene.p_OB + parameters.center[:, 0])
    mesh, shape = load_mesh(twin.mesh_path), upright_shape(twin.pusher)
    left = float((rotate(q, torch.from_numpy(np.array(mesh.vertices)))[:, 0]).min())
    p_WP = (left - shape.radius - _GAP, 0.0, float(p_WB[0, 2]))
    start = State.at_rest(scene.model, p_WB=tuple(p_WB[0].tolist()), q_WB=tuple(q.tolist()), p_WP=p_WP)
    return TwinPhysics(scene.model, parameters, start)
