"""Distance of pusher and object along the trajectory, which tells whether the two touch at all."""

from dataclasses import dataclass

import numpy as np
import torch
import trimesh
from scipy.spatial import cKDTree

from pinwm_drake.capture.episodes import PusherTrajectory
from pinwm_drake.capture.static_views import winding_number
from pinwm_drake.spatial.poses import Pose, compose, inverse, transform
from pinwm_drake.spatial.rotations import quaternion_to_matrix

_STEP = 0.003  # m, between looks at a moving pusher
_MOST_STEPS = 2000
_SPACING = 0.002  # m, of the points on the surfaces, about
_MOST_POINTS = 20_000
_REFINED, _NEAREST, _TRIANGLES = 8, 50, 1000  # looks, points and triangles whose distance is found exactly


@dataclass(frozen=True)
class Approach:
    """Nearest approach of a pusher to an object that stays where it starts.

    Attributes:
        distance: Least distance of the surfaces, m; exact to the spacing of points on the pusher, some 2 mm.
        t: Time of that distance, s.
        inside: Whether the pusher is in the object from the start, or the other way round.
    """

    distance: float
    t: float
    inside: bool


def approach(
    mesh: trimesh.Trimesh, X_WO: Pose, pusher: trimesh.Trimesh, trajectory: PusherTrajectory, end: float
) -> Approach:
    """Nearest approach of the pusher to the object.

    Args:
        mesh: The object, m, O.
        X_WO: Pose in which the object stays: q (4,), p (3,) [m].
        pusher: The pusher, m, P.
        trajectory: Motion of the pusher.
        end: End of the motion that counts, s.

    Returns:
        The nearest approach.
    """
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
    """Times (n,), positions (n, 3) and orientations (n, 4) of the pusher, near enough to one another."""
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
    """Flag: the middle of one surface's first face is inside the other surface."""
    p_O = transform(X_OP, torch.tensor(np.array(pusher.triangles_center[0]))).numpy()
    p_P = transform(inverse(X_OP), torch.tensor(np.array(mesh.triangles_center[0]))).numpy()
    return winding_number(mesh, p_O) > 0.5 or winding_number(pusher, p_P) > 0.5
