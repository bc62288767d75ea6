# SPDX-License-Identifier: MIT
"""Outline of a mesh seen from above."""

from typing import Any

import numpy as np
import trimesh
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection

_PIECES = 48  # of a line as long as a figure
_ASIDE = 1e-3  # how far beside a line one looks for the figure, as a share of its size
_AT_ONCE = 300_000  # pairs of point and triangle


def silhouette(mesh: trimesh.Trimesh, R_WB: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Silhouette of a mesh [m], turned by R_WB (3, 3): its triangles that face up, and the edges where they end.

    Returns:
        Triangles (n, 3, 2) and outline segments (m, 2, 2), x and y of the world from the body's origin [m].
    """
    vertices = mesh.vertices @ R_WB.T
    up = mesh.face_normals @ R_WB[2] > 1e-6
    outline = up[mesh.face_adjacency].sum(axis=1) == 1
    return vertices[mesh.faces[up]][..., :2], vertices[mesh.face_adjacency_edges[outline]][..., :2]


def boundary(triangles: np.ndarray, segments: np.ndarray) -> np.ndarray:
    """Boundary of a figure: the parts of segments with none of its triangles on the other side.

    The parts of a mesh may touch or overlap, so that the outline of one runs within another.

    Args:
        triangles: (n, 3, 2), the figure.
        segments: (m, 2, 2), the outlines of its parts, in the same unit.

    Returns:
        (k, 2, 2): the segments, cut into pieces that are short against the figure, each kept or left out.
    """
    if not len(triangles) or not len(segments):
        return segments
    size = float(np.ptp(triangles.reshape(-1, 2), axis=0).max())
    cut = np.concatenate([_cut(segment, size / _PIECES) for segment in segments])
    along = cut[:, 1] - cut[:, 0]
    length = np.linalg.norm(along, axis=1, keepdims=True)
    cut, along, length = (part[length[:, 0] > 0] for part in (cut, along, length))
    aside = _ASIDE * size * np.stack((-along[:, 1], along[:, 0]), axis=1) / length
    middle = cut.mean(axis=1)
    return cut[~(_inside(middle + aside, triangles) & _inside(middle - aside, triangles))]


def draw_outline(axes: Axes, mesh: trimesh.Trimesh, R_WB: np.ndarray, p_WB: np.ndarray, **style: Any) -> None:
    """Draws the boundary of a mesh [m] at the pose R_WB (3, 3), p_WB (3,) [m] from above, in millimetres.

    The style is that of a `LineCollection`.
    """
    lines = 1e3 * (boundary(*silhouette(mesh, R_WB)) + p_WB[:2])
    axes.add_collection(LineCollection(list(lines), **style))


def _cut(segment: np.ndarray, longest: float) -> np.ndarray:
    """Pieces (k, 2, 2) of a segment (2, 2), of equal length, `longest` at most."""
    number = max(int(np.ceil(np.linalg.norm(segment[1] - segment[0]) / longest)), 1)
    ends = segment[0] + np.linspace(0.0, 1.0, number + 1)[:, None] * (segment[1] - segment[0])
    return np.stack((ends[:-1], ends[1:]), axis=1)


def _inside(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Return flags: points (k, 2) are in any of the triangles (n, 3, 2)."""
    edges = np.roll(triangles, -1, axis=1) - triangles
    found = np.zeros(len(points), bool)
    step = max(_AT_ONCE // len(triangles), 1)
    for first in range(0, len(points), step):
        gaps = points[first : first + step, None, None] - triangles
        turns = edges[..., 0] * gaps[..., 1] - edges[..., 1] * gaps[..., 0]
        found[first : first + step] = ((turns > 0).all(axis=2) | (turns < 0).all(axis=2)).any(axis=1)
    return found
