# SPDX-License-Identifier: MIT
"""Predictions of a twin for the pusher's log of an episode, of its own capture or of another one."""

from dataclasses import dataclass, replace

import numpy as np
import torch

from pinwm_drake.capture.episodes import Episode, ObjectPoses
from pinwm_drake.capture.scene import Capture, PusherGeometry
from pinwm_drake.geometry.meshes import half_diagonal, load_mesh
from pinwm_drake.reading.contents import read_bytes
from pinwm_drake.spatial.poses import Pose
from pinwm_drake.spatial.rotations import quaternion_exp, quaternion_multiply, turn_between
from pinwm_drake.twin.drift import drift, typical_drift, way
from pinwm_drake.twin.frame import in_world
from pinwm_drake.twin.kicks import Kicks
from pinwm_drake.twin.origin import in_push, start_pose, time_offset
from pinwm_drake.twin.rollout import rollout, rollout_draws, rollout_kicks, twin_parameters, twin_scene
from pinwm_drake.twin.twin import Twin

# Differences that are taken for rounding: of gravity [m/s^2], and of a floor on which the object was said to rest [m].
_SAME_GRAVITY, _SAME_FLOOR = 1e-3, 1e-3
_DRAWS = 64  # that are rolled out for a spread
_ROUNDS = 3  # of a mean of orientations
TWO_SIDED = 1.96  # standard deviations within which are 95 % of a normal distribution


@dataclass(frozen=True, eq=False)
class Spread:
    """Standard deviations of a prediction in n frames: x, y of O in the world (n,) [m], yaw about z (n,) [rad]."""

    x: np.ndarray
    y: np.ndarray
    yaw: np.ndarray

    @property
    def position(self) -> np.ndarray:
        """Root mean square distance in the plane (n,) [m]."""
        return np.hypot(self.x, self.y)


def predict_motion(
    twin: Twin, capture: Capture, episode: Episode, push: int | None, *, start: Pose | None = None
) -> tuple[ObjectPoses, Spread | None]:
    """Return the poses of the object that a twin predicts for the frames of an episode, and their spread.

    For a push that was not identified, the poses are the mean of the rollouts of a number of the twin's draws: which is
    nearer, on average, than the rollout of their mean. The spread is that of the physics by the draws, and of what the
    physics cannot tell. A twin without draws has no spread; its poses, and those of an identified push, are the rollout
    of its estimates.

    Args:
        twin: The twin.
        capture: The capture of the episode, which says where the object starts.
        episode: The episode; of it, the pusher's log and the times of the frames are used.
        push: Number of the identified push that it is, see `origin.identified_push`; None for another one.
        start: Pose of the object in the first frame, where it is known better; q (4,), p (3,) [m].

    Raises:
        PinwmError: A mesh cannot be used, or the physics found no solution.
    """
    start, late = start or start_pose(twin, capture, push, episode), time_offset(twin, push)
    placed, t, V_WO = _in_place_of(in_push(twin, push), capture), episode.t + late, episode.start_velocity
    spread = None
    if twin.draws is not None:
        drawn = rollout_draws(placed, start, episode.trajectory, t, twin.draws.rows(_DRAWS), V_WO)
        scene, log = twin_scene(placed, start.q), in_world(twin, episode.trajectory)
        carried = rollout_kicks(scene, twin_parameters(placed, scene), start, log, t, V_WO)
        spread = spread_of(drawn, episode.t, twin, carried)
        if push is None:
            middle = mean_pose(drawn)
            return ObjectPoses(episode.t, middle.p.numpy(), middle.q.numpy()), spread
    found = rollout(placed, start, in_world(twin, episode.trajectory), t, V_WO)
    return ObjectPoses(episode.t, found.p_WO, found.q_WO), spread


def predict_poses(
    twin: Twin, capture: Capture, episode: Episode, push: int | None, *, start: Pose | None = None
) -> ObjectPoses:
    """Return the poses of `predict_motion`."""
    return predict_motion(twin, capture, episode, push, start=start)[0]


def predict_spread(
    twin: Twin, capture: Capture, episode: Episode, push: int | None, *, start: Pose | None = None
) -> Spread | None:
    """Return the spread of `predict_motion`."""
    return predict_motion(twin, capture, episode, push, start=start)[1]


def mean_pose(X_WO: Pose) -> Pose:
    """Mean (n,) of poses q (n, W, 4), p (n, W, 3) [m]: of positions, and of turns from a middle orientation."""
    q = X_WO.q[:, 0]
    for _ in range(_ROUNDS):
        q = quaternion_multiply(quaternion_exp(turn_between(q[:, None], X_WO.q).mean(1)), q)
    return Pose(q, X_WO.p.mean(1))


def spread_of(X_WO: Pose, t: np.ndarray, twin: Twin, carried: Kicks | None = None) -> Spread:
    """Spread of rollouts q (n, W, 4), p (n, W, 3) at times t (n,), with the drift that every push has.

    Of `kicks.carried_kicks`, carried is what errors of velocities make of the poses; None for none.
    """
    radius = half_diagonal(load_mesh(twin.mesh_path))
    made = way(Pose(X_WO.q.swapaxes(0, 1), X_WO.p.swapaxes(0, 1)), torch.from_numpy(t), radius).mean(0).numpy()
    turned = turn_between(X_WO.q[:, :1], X_WO.q)
    parts = torch.cat([turned[..., 2:], X_WO.p[..., :2]], -1).var(1, correction=0).numpy()
    walk, turn = typical_drift(twin)
    variances = parts + made[:, None] * drift(radius, walk, turn).numpy()[[2, 3, 4]] ** 2
    if carried is not None:
        variances += carried.root(walk).square().sum(-1).reshape(-1, 6)[:, [2, 3, 4]].numpy()
    yaw, x, y = np.sqrt(variances).T
    return Spread(x, y, yaw)


def mismatches(twin: Twin, capture: Capture) -> list[str]:
    """Differences of a capture's scene from that of the twin, in words."""
    found, of_twin, of_capture = [], twin.gravity, capture.gravity
    if read_bytes(twin.mesh_path) != read_bytes(capture.object.mesh_path):
        found.append(f"the twin's mesh is another one than {capture.object.mesh_path}; the twin's is used")
    if not _same_pusher(twin.pusher, capture.pusher):
        found.append(f"the twin's pusher is another one than that of {capture.folder}; the twin's is used")
    if abs(of_twin - of_capture) > _SAME_GRAVITY:
        found.append(f"gravity is {of_twin:g} m/s² in the twin; the {of_capture:g} m/s² of the capture are used")
    ours, theirs = 1e3 * (twin.floor_height - _lift(twin)), 1e3 * capture.floor_height
    if abs(ours - theirs) > 1e3 * _SAME_FLOOR:
        found.append(f"the floor is {ours:.1f} mm high in the twin; the {theirs:.1f} mm of the capture are used")
    return found


def _in_place_of(twin: Twin, capture: Capture) -> Twin:
    """Return the twin with the gravity of a capture and, unless it is the same but for the lift, on its floor."""
    floor = capture.floor_height + _lift(twin)
    same = abs(twin.floor_height - floor) <= _SAME_FLOOR
    return replace(twin, gravity=capture.gravity, floor_height=twin.floor_height if same else floor)


def _lift(twin: Twin) -> float:
    return twin.nuisance["lift"].value if "lift" in twin.nuisance else 0.0


def _same_pusher(twin: PusherGeometry, capture: PusherGeometry) -> bool:
    if twin.shape is not None or capture.shape is not None:
        return twin.shape == capture.shape
    if twin.mesh_path is None or capture.mesh_path is None:
        return twin.mesh_path == capture.mesh_path
    return read_bytes(twin.mesh_path) == read_bytes(capture.mesh_path)
