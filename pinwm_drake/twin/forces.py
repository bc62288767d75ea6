"""Force between object and pusher in a twin's physics, as a sensor in the pusher's stem reads it."""

import numpy as np
import torch

from pinwm_drake.capture.episodes import PusherTrajectory
from pinwm_drake.physics.impulses import contact_impulses
from pinwm_drake.physics.parameters import Parameters
from pinwm_drake.physics.stepper import Stepper
from pinwm_drake.scene import PAIR_PUSHER, PusherMotion, Scene, pusher_motion, start_state, step_count
from pinwm_drake.spatial.poses import Pose
from pinwm_drake.twin.rollout import resting_start, twin_parameters, twin_scene
from pinwm_drake.twin.twin import Twin


def pusher_force(twin: Twin, X_WO: Pose, trajectory: PusherTrajectory, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Force that the object exerts on the pusher along a motion of the pusher, as `trajectory.csv` has it.

    Args:
        twin: Geometry and theta.
        X_WO: Pose at t[0], at rest; q (4,), p (3,) [m]. Near the floor, it is put on it.
        trajectory: Motion of the pusher; its forces are not used.
        t: (n,) [s], not decreasing; the force is told from its first to its last.

    Returns:
        Times (T + 1,) [s] at which the steps of the physics begin and end, and the mean force in each step (T, 3) [N],
        world axes.

    Raises:
        InputError: A mesh cannot be used.
        SolverError: The physics found no solution.
    """
    scene = twin_scene(twin, X_WO.q)
    h, first = scene.model.time_step, float(t[0])
    steps = step_count(float(t[-1]) - first, h)
    start = resting_start(scene, X_WO)
    motion = pusher_motion(trajectory, first, steps, h)
    impulses = pusher_impulses(scene, twin_parameters(twin, scene), Pose(start.q[None], start.p[None]), motion)
    return first + h * np.arange(steps + 1), impulses[:, 0] / h


def pusher_impulses(
    scene: Scene, parameters: Parameters, X_WO: Pose, motion: PusherMotion, *, num_threads: int | None = None
) -> np.ndarray:
    """Impulses of the object on the pusher in every step of W rollouts.

    Args:
        scene, parameters, X_WO, motion, num_threads: As for `scene.rollout_poses`.

    Returns:
        (T, W, 3) N s, world axes.

    Raises:
        StateError: Shapes do not fit.
        SolverError: The physics found no solution.
    """
    start, V_WP = start_state(scene, parameters, X_WO, motion)
    with torch.no_grad():
        record = Stepper(scene.model, num_threads=num_threads).rollout(parameters, start, V_WP)
    on_object = contact_impulses(scene.model, parameters, record, V_WP, num_threads=num_threads)
    return -on_object[:, :, PAIR_PUSHER]
