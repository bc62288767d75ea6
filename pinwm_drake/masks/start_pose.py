# SPDX-License-Identifier: MIT
"""Pose of a mesh that stands on a table, from masks: resting faces times yaws, without a guess."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import trimesh
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from pinwm_drake.geometry.hull.visual import signed_distance
from pinwm_drake.masks.shading import unexplained
from pinwm_drake.masks.shots import CloseUp, Shot

_SIZE, _MARGIN = 110, 0.25  # px, of the boxes that are compared; margin around the object, of its size
_YAWS, _KEPT, _OF_FACE, _FEW = 36, 8, 4, 5  # starts for each face; those refined, of all and of a face; views for it
_LIKELY, _SAME_FACE = 0.02, np.radians(20)  # share of drops on a face, and angle between faces that count as one
_STEPS, _STILL = 15, (1e-5, 1e-4)  # of Gauss and Newton; m, rad: a step that ends them
_SOFT = 1.5  # px, beyond which residuals count less
_CORRELATED = 6.0  # px along an outline that err alike
_LIFT, _LEAN = 1e-3, np.radians(0.1)  # m, rad: standard deviations of what stands on a table from where it stands
_RIVAL, _APART, _ALIKE = 1.3, (5e-3, np.radians(5)), 1e-3  # misfit of a rival; how far it is; m, surfaces that are one
_SAMPLED = 0.5  # mean distance of random points from the nearest of as many others, of their spacing
_FEWEST = 20  # px of a mask
_SURE = 0.9  # of the variance that shading leaves in a rival: less, and the rival is none


@dataclass(frozen=True, eq=False)
class StartPose:
    """Pose of a mesh in the world.

    Attributes:
        X_WO: (4, 4) m.
        differing: Pixels in which outline and masks differ, as a share of those of the masks.
        place: m, standard deviation along the worst direction.
        turn: rad, the same of the rotation.
        rivals: Other poses (4, 4) that fit nearly as well, the better first.
    """

    X_WO: np.ndarray
    differing: float
    place: float
    turn: float
    rivals: list[np.ndarray]


@dataclass(frozen=True, eq=False)
class Outlines:
    """Masks and what is needed to compare outlines of a mesh with them."""

    shots: list[CloseUp]
    masks: list[np.ndarray]
    distances: list[np.ndarray]
    ignored: list[np.ndarray | None]

    @staticmethod
    def of(
        shots: Sequence[Shot], masks: Sequence[np.ndarray], size: int = _SIZE, ignored: Sequence[np.ndarray] = ()
    ) -> "Outlines":
        """Return the boxes around masks (H, W) bool, without those of a few px; ignored pixels do not count."""
        boxes, cut, hidden = [], [], []
        for k, (shot, mask) in enumerate(zip(shots, masks, strict=True)):
            if mask.sum() >= _FEWEST:
                rows, columns = np.nonzero(mask)
                wide = round(_MARGIN * max(np.ptp(rows), np.ptp(columns))) + 3
                left, top = max(columns.min() - wide, 0), max(rows.min() - wide, 0)
                right, bottom = min(columns.max() + wide + 1, mask.shape[1]), min(rows.max() + wide + 1, mask.shape[0])
                boxes.append(shot.close_up((int(left), int(top), int(right), int(bottom)), size))
                cut.append(boxes[-1].cut(mask))
                hidden.append(boxes[-1].cut(ignored[k]) if len(ignored) else None)
        return Outlines(boxes, cut, [signed_distance(mask) for mask in cut], hidden)

    def some(self, number: int) -> "Outlines":
        """Return so many of them, evenly."""
        rows = np.unique(np.linspace(0, len(self.shots) - 1, min(number, len(self.shots))).round().astype(int))
        pick = [[part[k] for k in rows] for part in (self.shots, self.masks, self.distances, self.ignored)]
        return Outlines(*pick)


def find_start_pose(
    outlines: Outlines, mesh: trimesh.Trimesh, floor: float, guess: np.ndarray | None = None
) -> StartPose | None:
    """Find the pose of a mesh on a table; None without a mask.

    Args:
        outlines: Masks of photos.
        mesh: m, frame O.
        floor: Height of the table, m, world.
        guess: Pose (4, 4) that is tried besides all others; or None.
    """
    if not outlines.shots:
        return None
    middle, few = mesh.bounds.mean(axis=0), outlines.some(_FEW)
    place = seen_at(outlines, floor + 0.5 * float(mesh.extents.min()))
    starts, faces = [] if guess is None else [guess], resting_faces(mesh)
    for up in faces:
        R_up = Rotation.align_vectors([[0.0, 0.0, 1.0]], [up])[0].as_matrix()
        for yaw in 2 * np.pi * np.arange(_YAWS) / _YAWS:
            X = np.eye(4)
            X[:3, :3] = Rotation.from_rotvec([0, 0, yaw]).as_matrix() @ R_up
            X[2, 3] = floor - (mesh.vertices @ X[2, :3]).min()
            X[:2, 3] = place[:2] - X[:2, :3] @ middle
            starts.append(X)
    worth = _worth(np.array([misfit(few, mesh, X) for X in starts]), len(starts) % _YAWS)
    refined = [refine(few, mesh, starts[k])[0] for k in worth]
    if guess is not None and 0 not in worth:
        refined.append(refine(few, mesh, guess)[0])
    losses = np.array([misfit(few, mesh, X) for X in refined])
    order = np.argsort(losses, kind="stable")
    close: list[np.ndarray] = []
    for k in order:
        near = losses[k] <= _RIVAL * losses[order[0]]
        if near and all(_differs(mesh, refined[k], other) for other in close):
            close.append(refined[k])
    shades = [unexplained(outlines.shots, mesh, X) for X in close] if len(close) > 1 else [1.0]
    first = int(np.argmin(shades)) if min(shades) < _SURE * shades[0] else 0
    rivals = [X for k, X in enumerate(close) if k != first and shades[k] * _SURE <= shades[first]]
    best, level = refine(outlines, mesh, close[first])[0], None
    if len(outlines.shots) > 1:
        level = standing(mesh, best, floor, faces)
        leaning, _ = refine(outlines, mesh, best, tilt=True, level=level)
        best = leaning if misfit(outlines, mesh, leaning) < misfit(outlines, mesh, level) else level
    _, covariance = refine(outlines, mesh, best, tilt=level is not None, level=level, steps=1)
    place_sd, turn_sd = deviations(covariance)
    return StartPose(best, misfit(outlines, mesh, best), place_sd, turn_sd, rivals)


def _worth(losses: np.ndarray, guesses: int) -> list[int]:
    """Numbers of the starts that are refined: the best ones, and not only turns of a body that is round."""
    kept: list[int] = []
    for k in np.argsort(losses, kind="stable").tolist():
        face = (k - guesses) // _YAWS
        if sum((other - guesses) // _YAWS == face for other in kept) < _OF_FACE and len(kept) < _KEPT:
            kept.append(k)
    return kept


def resting_faces(mesh: trimesh.Trimesh) -> list[np.ndarray]:
    """Return the directions (3,), frame O, that may point upwards where a mesh rests on a plane, likely ones first."""
    poses, shares = trimesh.poses.compute_stable_poses(mesh, n_samples=1, threshold=0.0)
    ups: list[np.ndarray] = []
    sums: list[float] = []
    for X, share in zip(poses, shares, strict=True):
        up = X[2, :3]
        near = [k for k, other in enumerate(ups) if up @ other > np.cos(_SAME_FACE)]
        if near:
            sums[near[0]] += share
        else:
            ups.append(up)
            sums.append(share)
    order = np.argsort(-np.array(sums), kind="stable")
    return [ups[k] for k in order if sums[k] >= _LIKELY] or [ups[order[0]]]


def standing(mesh: trimesh.Trimesh, X_WO: np.ndarray, floor: float, faces: Sequence[np.ndarray]) -> np.ndarray:
    """Pose (4, 4) of a mesh that stands on a table, by the least turn from another pose.

    Args:
        mesh: m, frame O.
        X_WO: (4, 4) m, the other pose.
        floor: Height of the table, m, world.
        faces: Directions (3,), frame O, that may point upwards; see `resting_faces`.
    """
    up = max(faces, key=lambda one: float(X_WO[2, :3] @ one))
    X, middle = X_WO.copy(), mesh.bounds.mean(axis=0)
    axis = np.cross(X[:3, :3] @ up, [0.0, 0.0, 1.0])
    sine, cosine = float(np.linalg.norm(axis)), float(X[2, :3] @ up)
    if sine > 0.0:
        X[:3, :3] = Rotation.from_rotvec(axis / sine * np.arctan2(sine, cosine)).as_matrix() @ X[:3, :3]
    X[:3, 3] = X_WO[:3, :3] @ middle + X_WO[:3, 3] - X[:3, :3] @ middle
    X[2, 3] = floor - (mesh.vertices @ X[2, :3]).min()
    return X


def misfit(outlines: Outlines, mesh: trimesh.Trimesh, X_WO: np.ndarray) -> float:
    """Pixels in which a mesh's outline at X_WO (4, 4) and the masks differ, as a share of those of the masks."""
    return sum(_differing(outlines, mesh, X_WO)) / sum(int(mask.sum()) for mask in outlines.masks)


def worst_view(outlines: Outlines, mesh: trimesh.Trimesh, X_WO: np.ndarray) -> tuple[str, float]:
    """Photo in which a mesh's outline at X_WO (4, 4) fits its mask worst, and the share of pixels that differ there."""
    differing = _differing(outlines, mesh, X_WO)
    shares = [number / int(mask.sum()) for number, mask in zip(differing, outlines.masks, strict=True)]
    k = int(np.argmax(shares))
    return outlines.shots[k].name, shares[k]


def _differing(outlines: Outlines, mesh: trimesh.Trimesh, X_WO: np.ndarray) -> list[int]:
    """Numbers of pixels in which a mesh's outline at X_WO (4, 4) and each mask differ."""
    pairs = zip(outlines.shots, outlines.masks, strict=True)
    return [int((shot.outline(mesh, X_WO) != mask).sum()) for shot, mask in pairs]


def refine(
    outlines: Outlines,
    mesh: trimesh.Trimesh,
    X_WO: np.ndarray,
    *,
    tilt: bool = False,
    level: np.ndarray | None = None,
    steps: int = _STEPS,
) -> tuple[np.ndarray, np.ndarray]:
    """Pose for which a mesh's outlines lie on those of the masks, and the covariance of place and turn.

    Args:
        outlines: The masks.
        mesh: m, frame O.
        X_WO: (4, 4) m, to begin with.
        tilt: Flag: all six degrees of freedom are free, and not x, y and yaw alone.
        level: Pose (4, 4) on the table, from which height and tilt hardly differ; or None.
        steps: Number of steps at the most.

    Returns:
        X_WO (4, 4), and (n, n), m^2 and rad^2, of x, y, z, rotation vector, or of x, y, yaw.
    """
    free = [0, 1, 2, 3, 4, 5] if tilt else [0, 1, 5]
    middle, damping, covariance = mesh.bounds.mean(axis=0), 1e-3, np.full((len(free),) * 2, np.inf)
    for _ in range(steps):
        rows = [_row(outlines, k, mesh, X_WO, middle) for k in range(len(outlines.shots))]
        J, r = np.concatenate([row[0] for row in rows])[:, free], np.concatenate([row[1] for row in rows])
        if len(r) <= len(free):
            break
        w = 1 / np.sqrt(1 + (r / _SOFT) ** 2)
        A, slope = J.T @ (w[:, None] * J), J.T @ (w * r)
        variance = _CORRELATED * float(np.mean(np.minimum(r**2, _SOFT**2)))
        if level is not None:
            precision = variance * np.array([0.0, 0.0, _LIFT**-2, _LEAN**-2, _LEAN**-2, 0.0])[free]
            A, slope = A + np.diag(precision), slope + precision * _move(X_WO, level, middle)[free]
        A += damping * np.diag(np.diag(A)) + 1e-9 * np.eye(len(free))
        covariance = np.linalg.inv(A) * variance
        d = np.zeros(6)
        d[free] = -np.linalg.solve(A, slope)
        X_WO = moved(X_WO, d, middle)
        if np.abs(d[:3]).max() < _STILL[0] and np.abs(d[3:]).max() < _STILL[1]:
            break
    return X_WO, covariance


def moved(X_WO: np.ndarray, d: np.ndarray, middle: np.ndarray) -> np.ndarray:
    """Pose (4, 4) moved by d (6,): place [m] and rotation vector about a point of O (3,) [m], axes of the world."""
    Y, at = np.eye(4), X_WO[:3, :3] @ middle + X_WO[:3, 3]
    Y[:3, :3] = Rotation.from_rotvec(d[3:]).as_matrix() @ X_WO[:3, :3]
    Y[:3, 3] = at + d[:3] - Y[:3, :3] @ middle
    return Y


def _move(X_WO: np.ndarray, other: np.ndarray, middle: np.ndarray) -> np.ndarray:
    """Place [m] and rotation vector (6,) that lead from the other pose (4, 4) to X_WO; see `moved`."""
    turn = Rotation.from_matrix(X_WO[:3, :3] @ other[:3, :3].T).as_rotvec()
    return np.concatenate([(X_WO - other)[:3, :3] @ middle + (X_WO - other)[:3, 3], turn])


def _row(
    outlines: Outlines, k: int, mesh: trimesh.Trimesh, X_WO: np.ndarray, middle: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Derivatives (n, 6) in the six freedoms and distances (n,) [px] of the pixels along a mesh's outline."""
    shot, distance, hidden = outlines.shots[k], outlines.distances[k], outlines.ignored[k]
    at, p_W = rim(shot, mesh, X_WO)
    if hidden is not None:
        seen = ~hidden[at[:, 1], at[:, 0]]
        at, p_W = at[seen], p_W[seen]
    if not len(at):
        return np.zeros((0, 6)), np.zeros(0)
    slope = np.stack(np.gradient(distance)[::-1], -1)[at[:, 1], at[:, 0]]
    return derivatives(shot, at, p_W, slope, X_WO[:3, :3] @ middle + X_WO[:3, 3]), distance[at[:, 1], at[:, 0]] - 0.5


def derivatives(shot: Shot, at: np.ndarray, p_W: np.ndarray, along: np.ndarray, middle: np.ndarray) -> np.ndarray:
    """Derivatives (n, 6) of a position in the photo along directions (n, 2), in place and turn about a middle (3,)."""
    P = shot.P
    depth = p_W @ P[2, :3] + P[2, 3]
    du = (P[None, :2, :3] - at[:, :, None] * P[None, 2:, :3]) / depth[:, None, None]  # by p_W
    g = np.einsum("ni,nij->nj", along, du)
    return np.concatenate([g, np.cross(p_W - middle, g)], axis=1)


def rim(shot: Shot, mesh: trimesh.Trimesh, X_WO: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pixels (n, 2) int, column and row, along a mesh's outline, and the points (n, 3) [m, world] that they show."""
    depth = shot.depth(mesh, X_WO)
    seen = np.pad(np.isfinite(depth), 1)
    inner = seen[1:-1, 1:-1] & seen[:-2, 1:-1] & seen[2:, 1:-1] & seen[1:-1, :-2] & seen[1:-1, 2:]
    edge = seen[1:-1, 1:-1] & ~inner
    edge[[0, -1]] = edge[:, [0, -1]] = False  # there the photo ends, not the mesh
    rows, columns = np.nonzero(edge)
    z = depth[rows, columns].astype(float)
    ray = np.linalg.solve(shot.K, np.stack([columns, rows, np.ones(len(rows))]))
    return np.stack([columns, rows], -1), ((ray * z).T - shot.X_CW[:3, 3]) @ shot.X_CW[:3, :3]


def seen_at(outlines: Outlines, height: float) -> np.ndarray:
    """Return the point (3,) [m, world] that is nearest to rays through the masks' middles; on a plane for one ray."""
    A, b = np.zeros((3, 3)), np.zeros(3)
    for shot, mask in zip(outlines.shots, outlines.masks, strict=True):
        rows, columns = np.nonzero(mask)
        ray = shot.X_CW[:3, :3].T @ np.linalg.solve(shot.K, [columns.mean(), rows.mean(), 1.0])
        ray /= np.linalg.norm(ray)
        across = np.eye(3) - np.outer(ray, ray)
        A, b = A + across, b + across @ shot.p_WC
    if len(outlines.shots) == 1:
        return shot.p_WC + ray * (height - shot.p_WC[2]) / ray[2]
    return np.linalg.lstsq(A, b, rcond=None)[0]


def deviations(covariance: np.ndarray) -> tuple[float, float]:
    """Largest standard deviations of place [m] and turn [rad], from the covariance (n, n) of `refine`."""
    if not np.isfinite(covariance).all():
        return np.inf, np.inf
    half = 3 if len(covariance) == 6 else 2
    worst = [
        float(np.sqrt(np.linalg.eigvalsh(part).max())) for part in (covariance[:half, :half], covariance[half:, half:])
    ]
    return worst[0], worst[1]


def _differs(mesh: trimesh.Trimesh, X: np.ndarray, Y: np.ndarray) -> bool:
    """Flag: two poses are apart, and not those of a body that looks the same in both."""
    turn = Rotation.from_matrix(X[:3, :3].T @ Y[:3, :3]).magnitude()
    middle = mesh.bounds.mean(axis=0)
    place = np.linalg.norm((X[:3, :3] - Y[:3, :3]) @ middle + X[:3, 3] - Y[:3, 3])
    if place < _APART[0] and turn < _APART[1]:
        return False
    points, _ = trimesh.sample.sample_surface(mesh, 4000, seed=0)
    there = (points @ X[:3, :3].T + X[:3, 3] - Y[:3, 3]) @ Y[:3, :3]
    apart = cKDTree(points).query(there)[0].mean() - _SAMPLED * np.sqrt(mesh.area / len(points))
    return bool(apart > _ALIKE)
