"""Checks of the pusher's log: agreement of its columns, and the way to the object."""

from pathlib import Path

import numpy as np
import torch
import trimesh

from pinwm_drake.capture.checks.findings import Findings
from pinwm_drake.capture.checks.scene import Scene
from pinwm_drake.capture.checks.touch import approach
from pinwm_drake.capture.episode_tables import TRAJECTORY_FILE, PusherTrajectory
from pinwm_drake.errors import InputError
from pinwm_drake.spatial.rotations import quaternion_to_matrix

_NEAR = 0.005  # m; a pusher that never comes nearer does not touch
_ASTRAY = 0.002, 0.1  # m and share: how far a step may be from the commanded velocity
_TURN = np.radians(2.0)  # rad; the physics moves a pusher without turning it
_SUNK = 0.002  # m below the floor
_FAST = 1.5  # m/s


def check_motion(
    folder: Path, trajectory: PusherTrajectory, frames_t: np.ndarray | None, scene: Scene, findings: Findings
) -> None:
    """Checks the pusher's log, without NaN, of an episode with images at `frames_t` (n,) [s], where these are known."""
    path = folder / TRAJECTORY_FILE
    _check_velocity(path, trajectory, findings)
    cosine = np.abs(trajectory.q_WP @ trajectory.q_WP[0]).clip(0, 1)
    turn = 2 * float(np.arccos(cosine).max())
    if turn > _TURN:
        findings.warn(path, f"a pusher that turns by {np.degrees(turn):.1f} deg", "a pusher that only translates")
    if trajectory.force_W is not None and np.ptp(trajectory.force_W, axis=0).max() == 0 and len(trajectory.t) > 1:
        findings.warn(path, "forces fx, fy, fz that never change", "measured forces, or no such columns")
    if scene.pusher is not None and scene.floor_height is not None:
        _check_floor(path, trajectory, scene.pusher, scene.floor_height, findings)
    if scene.mesh is not None and scene.X_WO is not None and scene.pusher is not None:
        end = float(trajectory.t[-1] if frames_t is None else frames_t[-1])
        near = approach(scene.mesh, scene.X_WO, scene.pusher, trajectory, end)
        if near.inside:
            findings.warn(path, "a pusher that starts inside the object", "a pusher that starts beside it", row=2)
        elif near.distance > _NEAR:
            found = f"a pusher that never touches the object: {1000 * near.distance:.1f} mm off at t = {near.t:.3f} s"
            findings.error(InputError(path, value=found, allowed=f"contact, or {1000 * _NEAR:g} mm from it"))


def _check_velocity(path: Path, trajectory: PusherTrajectory, findings: Findings) -> None:
    """Warns where the pusher does not go where it is commanded to, and of high speeds."""
    moved, v = np.diff(trajectory.p_WP, axis=0), trajectory.v_WP[:-1]
    expected = v * np.diff(trajectory.t)[:, None]
    off = np.linalg.norm(moved - expected, axis=-1)
    allowed = _ASTRAY[0] + _ASTRAY[1] * np.linalg.norm(expected, axis=-1)
    if (off > allowed).any():
        k = int(np.argmax(off - allowed))
        found = f"{int((off > allowed).sum())} steps that differ from vx, vy, vz, this one by {1000 * off[k]:.1f} mm"
        findings.warn(path, found, "positions that follow the commanded velocity of the row before", row=k + 3)
    speed = np.linalg.norm(moved, axis=-1) / np.diff(trajectory.t) if len(moved) else np.zeros(1)
    if speed.max() > _FAST:
        row = int(speed.argmax()) + 2
        findings.warn(path, f"a speed of {speed.max():.3g} m/s from this row to the next", f"{_FAST:g} m/s", row=row)


def _check_floor(
    path: Path, trajectory: PusherTrajectory, pusher: trimesh.Trimesh, height: float, findings: Findings
) -> None:
    """Warns of a pusher below the floor."""
    ways, which = np.unique(trajectory.q_WP, axis=0, return_inverse=True)
    down = quaternion_to_matrix(torch.from_numpy(ways))[:, 2].numpy()
    reach = np.array([(pusher.vertices @ axis).min() for axis in down])
    lowest = reach[which.ravel()] + trajectory.p_WP[:, 2]
    k = int(lowest.argmin())
    if lowest[k] < height - _SUNK:
        found = f"a pusher {1000 * (height - lowest[k]):.1f} mm below the floor"
        findings.warn(path, found, "a pusher above the floor", row=k + 2)
