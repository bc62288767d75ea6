# SPDX-License-Identifier: MIT
"""Masks of a mesh: its outline at a pose that edges of the photos settle, whatever the table's colour."""

from collections.abc import Sequence

import cv2
import numpy as np
import trimesh

from pinwm_drake.geometry.hull.visual import signed_distance
from pinwm_drake.masks.shots import CloseUp
from pinwm_drake.masks.start_pose import derivatives, moved, rim

_REACH, _STEP = 6.0, 0.5  # px, how far along the outline's normal edges are looked for
_ROUNDS, _SOFT = 6, 1.0  # rounds of search; px, beyond which an edge counts less
_STRONG = 5.0  # of the median edge of a photo; more is no better


def settle(shots: Sequence[CloseUp], mesh: trimesh.Trimesh, X_WO: np.ndarray) -> np.ndarray:
    """Pose (4, 4) for which a mesh's outlines lie on edges of the photos, all together, from a near one."""
    middle = mesh.bounds.mean(axis=0)
    pictures = [_edges(shot.image) for shot in shots]
    for number in range(_ROUNDS):
        reach, rows = _REACH / (1 + number), []
        for shot, picture in zip(shots, pictures, strict=True):
            at, p_W = rim(shot, mesh, X_WO)
            if len(at):
                normal, offset, weight = _offsets(picture, at, _normals(shot, mesh, X_WO, at), max(reach, 2.0))
                J = derivatives(shot, at, p_W, normal, X_WO[:3, :3] @ middle + X_WO[:3, 3])
                rows.append((J, offset, weight))
        if not rows:
            return X_WO
        J, r, w = (np.concatenate(part) for part in zip(*rows, strict=True))
        w = w / np.sqrt(1 + (r / _SOFT) ** 2)
        A = J.T @ (w[:, None] * J) + 1e-9 * np.eye(6)
        X_WO = moved(X_WO, np.linalg.solve(A, J.T @ (w * r)), middle)
    return X_WO


def edge_strength(shots: Sequence[CloseUp], mesh: trimesh.Trimesh, X_WO: np.ndarray) -> float:
    """Mean strength of the edges on a mesh's outlines at X_WO (4, 4), against that of photos; larger where right."""
    found = []
    for shot in shots:
        (at, _), edges = rim(shot, mesh, X_WO), _edges(shot.image)
        found.append(
            np.minimum(edges[at[:, 1], at[:, 0]] / (np.median(edges) + 1e-6), _STRONG).mean() if len(at) else 0.0
        )
    return float(np.mean(found))


def mesh_mask(shot: CloseUp, mesh: trimesh.Trimesh, X_WO: np.ndarray) -> np.ndarray:
    """Outline (h, w) bool of a mesh, put where edges of the photo have it: cameras are a little off.

    Args:
        shot: The photo.
        mesh: m, frame O.
        X_WO: (4, 4) m.
    """
    whole = shot.outline(mesh, X_WO)
    at, _ = rim(shot, mesh, X_WO)
    if not len(at):
        return whole
    normal, offset, weight = _offsets(_edges(shot.image), at, _normals(shot, mesh, X_WO, at), 0.5 * _REACH)
    shift = np.zeros(2)
    for _ in range(5):
        r = offset - normal @ shift
        w = weight / np.sqrt(1 + (r / _SOFT) ** 2)
        shift += np.linalg.solve(normal.T @ (w[:, None] * normal) + 1e-3 * np.eye(2), normal.T @ (w * r))
    return shot.moved(shift).outline(mesh, X_WO)


def _edges(image: np.ndarray) -> np.ndarray:
    """Strength (H, W) float32 of the edges of a photo (H, W, 3) uint8, colours counting as much as lightness."""
    lab = cv2.GaussianBlur(cv2.cvtColor(image, cv2.COLOR_RGB2LAB), (0, 0), 1.0).astype(np.float32)
    slopes = [np.hypot(*np.gradient(lab[..., k])) for k in range(3)]
    return np.sqrt(sum(slope**2 for slope in slopes)).astype(np.float32)


def _normals(shot: CloseUp, mesh: trimesh.Trimesh, X_WO: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Directions (n, 2) out of a mesh's outline at pixels (n, 2) along it."""
    soft = cv2.GaussianBlur(signed_distance(shot.outline(mesh, X_WO)), (0, 0), 1.5)
    out = -np.stack(np.gradient(soft)[::-1], -1)[at[:, 1], at[:, 0]]
    return out / np.maximum(np.linalg.norm(out, axis=1, keepdims=True), 1e-6)


def _offsets(
    edges: np.ndarray, at: np.ndarray, normal: np.ndarray, reach: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Normals, distances (n,) [px] outwards to the strongest edge within a reach, and weights (n,)."""
    steps = np.arange(-reach, reach + _STEP, _STEP)
    # The rim's pixels lie half a pixel within the outline.
    places = (at[:, None] + (0.5 + steps)[None, :, None] * normal[:, None]).astype(np.float32)
    found = cv2.remap(edges, places[..., 0], places[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    best = (found * np.exp(-0.5 * (steps / reach) ** 2)).argmax(axis=1)
    strength = found[np.arange(len(at)), best]
    return normal, steps[best], strength / (strength + np.median(edges) + 1e-6)
