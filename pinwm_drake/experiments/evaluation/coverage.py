# SPDX-License-Identifier: MIT
"""Coverage of the goal: how much of the goal's outline the object covers, seen from above."""

import cv2
import numpy as np
import trimesh

_PIXELS = 1024  # along the longer side of both outlines together
_FRACTION = 4  # bits of a pixel in the corners of triangles


def coverage(mesh: trimesh.Trimesh, X_WO: np.ndarray, X_WG: np.ndarray) -> float:
    """Share of the goal's area, seen along z, that an object covers; 0 to 1, to about 1/500.

    Args:
        mesh: The object, m, frame O.
        X_WO: (4, 4), pose of the object in the world.
        X_WG: (4, 4), pose of the object at the goal.

    Source: Chi et al., "Diffusion Policy" (RSS 2023), Push-T: intersection over the goal's area.
    """
    placed = [trimesh.transform_points(mesh.vertices, X)[:, :2] for X in (X_WO, X_WG)]
    low, high = np.min([points.min(0) for points in placed], 0), np.max([points.max(0) for points in placed], 0)
    scale = (_PIXELS - 1) / float((high - low).max())
    covered, goal = (_outline((points - low) * scale, mesh.faces) for points in placed)
    return float((covered & goal).sum() / goal.sum())


def _outline(corners: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Mask (n, n) bool of triangles whose corners (m, 2) are in pixels."""
    mask = np.zeros((_PIXELS, _PIXELS), np.uint8)
    for triangle in np.round(corners[faces] * (1 << _FRACTION)).astype(np.int32):
        cv2.fillConvexPoly(mask, triangle, 1, shift=_FRACTION)
    return mask.astype(bool)
