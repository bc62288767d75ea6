# SPDX-License-Identifier: MIT
"""Checks of the pusher's log: agreement of its columns, and the way to the object."""

from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
import trimesh
from scipy.spatial import cKDTree

from pinwm_drake.capture.checks.findings import Findings
from pinwm_drake.capture.checks.scene import Scene
from pinwm_drake.capture.episode_tables import TRAJECTORY_FILE, PusherTrajectory
from pinwm_drake.capture.static_views import winding_number
from pinwm_drake.capture.units import position_doubts
from pinwm_drake.errors import InputError
from pinwm_drake.spatial.poses import Pose, compose, inverse, transform
from pinwm_drake.spatial.rotations import quaternion_to_matrix

_NEAR = 0.005  # m; a pusher that never comes nearer does not touch
_ASTRAY = 0.002, 0.1  # m and share: how far a step may be from the commanded velocity
_TURN = np.radians(2.0)  # rad; the physics moves a pusher without turning it
_SUNK = 0.002  # m below the floor
_FAST = 1.5  # m/s
_STEP = 0.003  # m, between looks at a moving pusher
_MOST_STEPS = 2000
_SPACING = 0.002  # m, of the points on the surfaces, about
_MOST_POINTS = 20_000
_REFINED, _NEAREST, _TRIANGLES = 8, 50, 1000  # looks, points and triangles whose distance is found exactly


def check_motion(
    folder: Path, trajectory: PusherTrajectory, frames_t: np.ndarray | None, scene: Scene, findings: Findings
) -> None:
    """Check the pusher's log, without NaN, of an episode with images at `frames_t` (n,) [s], where these are known."""
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
    if scene.mesh is not None and scene.X_WO is not None:
        findings.doubt(position_doubts(folder, trajectory, scene.mesh, scene.X_WO, scene.pusher))
    if scene.mesh is not None and scene.X_WO is not None and scene.pusher is not None:
        end = float(trajectory.t[-1] if frames_t is None else frames_t[-1])
        near = approach(scene.mesh, scene.X_WO, scene.pusher, trajectory, end)
        if near.inside:
            findings.warn(path, "a pusher that starts inside the object", "a pusher that starts beside it", row=2)
        elif near.distance > _NEAR:
            found = f"a pusher that never touches the object: {1000 * near.distance:.1f} mm off at t = {near.t:.3f} s"
            findings.error(InputError(path, value=found, allowed=f"contact, or {1000 * _NEAR:g} mm from it"))


def _check_velocity(path: Path, trajectory: PusherTrajectory, findings: Findings) -> None:
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
    ways, which = np.unique(trajectory.q_WP, axis=0, return_inverse=True)
    down = quaternion_to_matrix(torch.from_numpy(ways))[:, 2].numpy()
    reach = np.array([(pusher.vertices @ axis).min() for axis in down])
    lowest = reach[which.ravel()] + trajectory.p_WP[:, 2]
    k = int(lowest.argmin())
    if lowest[k] < height - _SUNK:
        found = f"a pusher {1000 * (height - lowest[k]):.1f} mm below the floor"
        findings.warn(path, found, "a pusher above the floor", row=k + 2)


class Approach(NamedTuple):
    """Nearest approach of a pusher to an object that stays where it starts."""

    distance: float  # m, of the surfaces; exact to the spacing of points on the pusher, some 2 mm
    t: float  # s
    inside: bool  # one is in the other from the start


def approach(
    mesh: trimesh.Trimesh, X_WO: Pose, pusher: trimesh.Trimesh, trajectory: PusherTrajectory, end: float
) -> Approach:
    """Nearest approach of a pusher [m, P] to an object [m, O] that stays at X_WO, up to a time [s]."""
    tree, points = cKDTree(_points(mesh)), _points(pusher)
    gap = 2 * max(_SPACING, float(np.sqrt(mesh.area / _MOST_POINTS)))  # between the points on the object, at most
    t, p_WP, q_WP = _steps(trajectory, end)
    X_OP = compose(inverse(X_WO), Pose(torch.from_numpy(q_WP), torch.from_numpy(p_WP)))
    R_OP, p_OP = quaternion_to_matrix(X_OP.q).numpy(), X_OP.p.numpy()
    # What a ball around each surface allows is skipped where something nearer is known.
    centre_O, radius_O = _ball(mesh)
    centre_P, radius_P = _ball(pusher)
    least = np.linalg.norm(R_OP @ centre_P + p_OP - centre_O, axis=-1) - radius_O - radius_P
    distance, looks = np.inf, []
    for k in np.argsort(least).tolist():
        if least[k] >= distance or distance <= 0.5 * _SPACING:
            break
        p_OQ = points @ R_OP[k].T + p_OP[k]
        to_points = tree.query(p_OQ, distance_upper_bound=distance + gap)[0]
        distance = min(distance, float(to_points.min()))
        looks.append((float(to_points.min()), k, p_OQ[np.argsort(to_points)[:_NEAREST]]))
    # To the points is farther than to the surface between them.
    best = sorted(looks, key=lambda look: look[0])[:_REFINED]
    distance, k = min((_to_surface(mesh, p_OQ, about), k) for about, k, p_OQ in best)
    return Approach(distance, float(t[k]), _inside(mesh, pusher, Pose(X_OP.q[0], X_OP.p[0])))


def _to_surface(mesh: trimesh.Trimesh, p_OQ: np.ndarray, about: float) -> float:
    """Distance [m] of points (n, 3) from a surface, about which it is known that it is no more than `about`."""
    triangles = np.asarray(mesh.triangles)
    centres = triangles.mean(axis=1)
    radii = np.linalg.norm(triangles - centres[:, None], axis=-1).max(axis=1)
    least = cKDTree(p_OQ).query(centres)[0] - radii
    near = np.argsort(least)[:_TRIANGLES]
    near = near[least[near] <= about]
    if not len(near):
        return about
    pairs = np.repeat(triangles[near], len(p_OQ), axis=0), np.tile(p_OQ, (len(near), 1))
    return min(about, float(np.linalg.norm(trimesh.triangles.closest_point(*pairs) - pairs[1], axis=-1).min()))


def _steps(trajectory: PusherTrajectory, end: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Time (n,), positions (n, 3) and orientations (n, 4) of the pusher, near enough to one another."""
    t = trajectory.t
    travelled = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(trajectory.p_WP, axis=0), axis=-1))])
    count = int(min(max(travelled[-1] / _STEP, 1.0), _MOST_STEPS)) + 1
    even = np.interp(np.linspace(0.0, travelled[-1], count), travelled + 1e-9 * np.arange(len(t)), t)
    times = np.unique(np.concatenate([even, t if len(t) <= _MOST_STEPS else t[:1]]))
    times = times[times <= max(end, t[0])]
    p_WP = np.stack([np.interp(times, t, trajectory.p_WP[:, k]) for k in range(3)], axis=-1)
    return times, p_WP, trajectory.q_WP[np.clip(np.searchsorted(t, times, side="right") - 1, 0, len(t) - 1)]


def _points(mesh: trimesh.Trimesh) -> np.ndarray:
    """Points (n, 3) all over a surface, its corners among them."""
    count = int(np.clip(mesh.area / _SPACING**2, 500, _MOST_POINTS))
    return np.concatenate([mesh.vertices, trimesh.sample.sample_surface(mesh, count, seed=0)[0]])


def _ball(mesh: trimesh.Trimesh) -> tuple[np.ndarray, float]:
    middle = np.mean(mesh.bounds, axis=0)
    return middle, float(np.linalg.norm(mesh.vertices - middle, axis=-1).max())


def _inside(mesh: trimesh.Trimesh, pusher: trimesh.Trimesh, X_OP: Pose) -> bool:
    # The middle of one surface's first face is inside the other surface.
    p_O = transform(X_OP, torch.tensor(np.array(pusher.triangles_center[0]))).numpy()
    p_P = transform(inverse(X_OP), torch.tensor(np.array(mesh.triangles_center[0]))).numpy()
    return winding_number(mesh, p_O) > 0.5 or winding_number(pusher, p_P) > 0.5
