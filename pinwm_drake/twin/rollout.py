"""Prediction by a twin: its physics along a pusher's motion."""

from dataclasses import replace

import numpy as np
import torch

from pinwm_drake.capture.episodes import ObjectPoses, PusherTrajectory
from pinwm_drake.errors import SolverError
from pinwm_drake.physics.parameters import Parameters
from pinwm_drake.scene import (
    Scene,
    make_scene,
    pusher_motion,
    resting_height,
    rollout_poses,
    scaled_inertia,
    step_count,
)
from pinwm_drake.spatial.poses import Pose
from pinwm_drake.twin.twin import Twin

# An object that starts this near to the floor [m] rests on it; one that is farther up falls.
_RESTS = 5e-3
# Where the contacts of a step have no solution that the solvers find, smaller steps meet others.
_HALVINGS = 4


def twin_scene(twin: Twin, q_WO: torch.Tensor) -> Scene:
    """The physics of a twin that starts in an orientation q_WO (4,).

    Raises:
        InputError: A mesh cannot be used.
    """
    return make_scene(
        twin.mesh_path,
        twin.pusher,
        q_WO=q_WO,
        gravity=twin.gravity,
        floor_height=twin.floor_height,
        time_step=twin.time_step,
        friction_directions=twin.friction_directions,
        support=twin.support,
    )


def twin_parameters(twin: Twin, scene: Scene) -> Parameters:
    """Parameters theta of one world. Products of inertia are those of the mesh, scaled like the moments."""
    theta = {key: estimate.value for key, estimate in twin.theta.items()}
    solid = torch.as_tensor(scene.model.bodies[0].inertia, dtype=torch.float64).diagonal()
    moments = torch.tensor([theta["inertia_xx"], theta["inertia_yy"], theta["inertia_zz"]], dtype=torch.float64)
    # Second moments of mass along the axes: they scale independently, moments of inertia do not.
    second, wanted = (0.5 * diagonal.sum() - diagonal for diagonal in (solid, moments))
    factors = wanted.clamp_min(0.0) / second.clamp_min(1e-300)
    return Parameters(
        mass=torch.tensor([[theta["mass"]]], dtype=torch.float64),
        inertia=scaled_inertia(scene, 1.0, factors)[None, None],
        friction=torch.tensor([[theta["friction_floor"], theta["friction_pusher"]]], dtype=torch.float64),
        restitution=torch.tensor([[theta["restitution_floor"], theta["restitution_pusher"]]], dtype=torch.float64),
    )


def rollout(twin: Twin, X_WO: Pose, trajectory: PusherTrajectory, t: np.ndarray) -> ObjectPoses:
    """Poses of the object along a motion of the pusher.

    Args:
        twin: Geometry and theta.
        X_WO: Pose at t[0], at rest; q (4,), p (3,) [m]. Near the floor, it is put on it.
        trajectory: Motion of the pusher.
        t: (n,) [s], not decreasing.

    Returns:
        The poses at t.

    Raises:
        InputError: A mesh cannot be used.
        SolverError: The physics found no solution, at the twin's time step nor at smaller ones.
    """
    steps = (twin.time_step / 2**halving for halving in range(_HALVINGS))
    for step in steps:
        try:
            return _rollout(replace(twin, time_step=step), X_WO, trajectory, np.asarray(t, float))
        except SolverError as error:
            failure = error
    raise failure


def _rollout(twin: Twin, X_WO: Pose, trajectory: PusherTrajectory, t: np.ndarray) -> ObjectPoses:
    """Rollout at the twin's own time step; arguments as for `rollout`."""
    scene = twin_scene(twin, X_WO.q)
    rest = resting_height(scene, X_WO.q)
    p_WO = X_WO.p.clone()
    if abs(float(p_WO[2]) - rest) < _RESTS:
        p_WO[2] = rest
    h = scene.model.time_step
    motion = pusher_motion(trajectory, float(t[0]), step_count(t[-1] - t[0], h), h)
    with torch.no_grad():
        found = rollout_poses(
            scene,
            twin_parameters(twin, scene),
            Pose(X_WO.q[None], p_WO[None]),
            motion,
            torch.from_numpy(t - t[0]),
        )
    return ObjectPoses(t=t, p_WO=found.p[:, 0].numpy(), q_WO=found.q[:, 0].numpy())
