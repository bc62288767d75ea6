# SPDX-License-Identifier: MIT
"""Planar model of an object: cells of the face that it rests on, and outlines at the height at which it is pushed."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
import trimesh
from scipy.spatial import ConvexHull
from torch import Tensor

from pinwm_drake.errors import ParameterError, require
from pinwm_drake.geometry.meshes import load_mesh
from pinwm_drake.geometry.pieces import ConvexPiece
from pinwm_drake.geometry.stored_pieces import mesh_pieces
from pinwm_drake.spatial.rotations import quaternion_to_matrix

# The face below: its triangles are this near to the lowest point [m], and fill this share of the object's box.
_FLAT, _SMALLEST_SHARE = 2e-4, 0.1
_FINE = 120  # points to each side that measure an area
_SIZES = np.linspace(0.85, 1.15, 61)  # sides of cells that are tried, over that of an area cut evenly


@dataclass(frozen=True, eq=False)
class PlanarBody:
    """Geometry of an object that slides on a plane; frame Q has its origin in O, and z up.

    Attributes:
        cells: (C, 2) float64, middles of the square cells, m, frame Q.
        size: Side of a cell, m.
        outlines: (P, E, 2) float64, convex polygons, counter-clockwise, m, frame Q; the last corner of one with fewer
            than E is repeated.
        R_QO: (3, 3), rotation from the mesh's frame O.
    """

    cells: Tensor
    size: float
    outlines: Tensor
    R_QO: np.ndarray

    def neighbours(self) -> Tensor:
        """Pairs (N, 2) of cells that share a side."""
        apart = (self.cells[:, None] - self.cells[None]).abs().sum(-1)
        return torch.nonzero(torch.triu((apart < 1.2 * self.size), diagonal=1))

    def planar(self, q_WO: np.ndarray, p_WO: np.ndarray) -> np.ndarray:
        """Planar poses of the frame Q.

        Args:
            q_WO: (N, 4), wxyz.
            p_WO: (N, 3), m.

        Returns:
            (N, 3): x, y [m] and yaw [rad], which goes on beyond a full turn.
        """
        R_WQ = quaternion_to_matrix(torch.as_tensor(q_WO, dtype=torch.float64)).numpy() @ self.R_QO.T
        yaw = np.arctan2(R_WQ[:, 1, 0] - R_WQ[:, 0, 1], R_WQ[:, 0, 0] + R_WQ[:, 1, 1])
        return np.column_stack([np.asarray(p_WO, float)[:, :2], np.unwrap(yaw)])


def make_planar_body(mesh_path: Path, q_WO: Tensor, low: float, high: float, *, cells: int = 80) -> PlanarBody:
    """Planar model of an object in the orientation in which it slides.

    The cells cover the flat face that it rests on; where it has none, they cover what is seen of it from above.

    Args:
        mesh_path: The object's mesh, m, frame O.
        q_WO: (4,), wxyz, orientation at rest; z of W is up.
        low, high: Lowest and highest height at which a pusher touches it, m above O.
        cells: Number of cells, 4 or more, met within a few.

    Returns:
        The model.

    Raises:
        InputError: The mesh cannot be used.
        ParameterError: The number of cells is out of range, or there is nothing of the object at these heights.
    """
    require("cells", cells, cells >= 4, "4 or more")
    R_QO = _upright(quaternion_to_matrix(torch.as_tensor(q_WO, dtype=torch.float64)).numpy())
    mesh = load_mesh(mesh_path)
    middles, size = _cells(_face(mesh, R_QO), cells)
    loops = [loop for piece in mesh_pieces(mesh_path) if (loop := _silhouette(piece, R_QO, low, high)) is not None]
    if not loops:
        ends = mesh.vertices @ R_QO[2]
        raise ParameterError(
            f"low, high: got {low:g} and {high:g} m; allowed: heights of the object, {ends.min():g} to {ends.max():g} m"
        )
    longest = max(len(loop) for loop in loops)
    padded = np.stack([np.pad(loop, ((0, longest - len(loop)), (0, 0)), mode="edge") for loop in loops])
    return PlanarBody(torch.from_numpy(middles), size, torch.from_numpy(padded), R_QO)


def _upright(R_WO: np.ndarray) -> np.ndarray:
    """Rotation R_QO: that of R_WO without its turn about z, so that an axis of O which is level is an axis of Q."""
    axis = int(np.argmin(np.abs(R_WO[2])))
    yaw = np.arctan2(R_WO[1, axis], R_WO[0, axis])
    turn = np.array([[np.cos(yaw), np.sin(yaw), 0.0], [-np.sin(yaw), np.cos(yaw), 0.0], [0.0, 0.0, 1.0]])
    return np.asarray(turn @ R_WO)


def _face(mesh: trimesh.Trimesh, R_QO: np.ndarray) -> np.ndarray:
    """Triangles (n, 3, 2) [m, frame Q] of the face below, or all, seen from above."""
    points = mesh.vertices @ R_QO.T
    level = points[:, :2][mesh.faces]
    flat = (points[:, 2][mesh.faces] < points[:, 2].min() + _FLAT).all(axis=1)
    u, v = level[:, 1] - level[:, 0], level[:, 2] - level[:, 0]
    area = 0.5 * np.abs(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])
    footprint = float(np.prod(np.ptp(points[:, :2], axis=0)))
    chosen = flat if float(area[flat].sum()) >= _SMALLEST_SHARE * footprint else np.ones(len(level), bool)
    return np.asarray(level[chosen & (area > 0.0)])


def _cells(triangles: np.ndarray, number: int) -> tuple[np.ndarray, float]:
    """Middles (C, 2) of cells that cover triangles (n, 3, 2), and their side, m."""
    low, high = triangles.min(axis=(0, 1)), triangles.max(axis=(0, 1))
    step = (high - low) / _FINE
    fine = _grid(low, high, step)
    area = float(_within(fine, triangles).mean()) * float(np.prod(high - low))
    best = np.zeros((0, 2))
    size = 0.0
    for side in np.sqrt(area / number) * _SIZES[np.argsort(np.abs(_SIZES - 1.0))]:
        grid = _grid(low, high, np.array([side, side]))
        found = grid[_within(grid, triangles)]
        if abs(len(found) - number) < abs(len(best) - number):
            best, size = found, float(side)
    return best, size


def _grid(low: np.ndarray, high: np.ndarray, step: np.ndarray) -> np.ndarray:
    """Middles (n, 2) of the squares of a grid, whose middle is that of the box from low to high (2,)."""
    axes = []
    for axis in range(2):
        count = max(int(np.ceil((high[axis] - low[axis]) / step[axis] - 1e-6)), 1)
        axes.append(0.5 * (low[axis] + high[axis]) + step[axis] * (np.arange(count) - 0.5 * (count - 1)))
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)


def _within(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Flag (n,) of the points (n, 2) that are in one of the triangles (m, 3, 2)."""
    inside = np.zeros(len(points), bool)
    for triangle in triangles:
        edges, away = np.roll(triangle, -1, axis=0) - triangle, points[:, None] - triangle
        side = edges[:, 0] * away[..., 1] - edges[:, 1] * away[..., 0]
        inside |= (side >= 0.0).all(axis=1) | (side <= 0.0).all(axis=1)
    return inside


def _silhouette(piece: ConvexPiece, R_QO: np.ndarray, low: float, high: float) -> np.ndarray | None:
    """Corners (n, 2) [m, frame Q] of a convex piece between two heights, seen from above; None for nothing."""
    points = piece.vertices @ R_QO.T
    ends = [(face[k - 1], face[k]) for face in piece.faces for k in range(len(face))]
    a, b = (points[[end[k] for end in ends]] for k in range(2))
    found = [points[(points[:, 2] >= low) & (points[:, 2] <= high)]]
    for height in (low, high):
        cut = (a[:, 2] - height) * (b[:, 2] - height) < 0.0
        share = (height - a[cut, 2]) / (b[cut, 2] - a[cut, 2])
        found.append(a[cut] + share[:, None] * (b[cut] - a[cut]))
    level = np.concatenate(found)[:, :2]
    if len(level) < 3 or np.linalg.matrix_rank(level - level.mean(axis=0), tol=1e-6) < 2:
        return None
    return np.asarray(level[ConvexHull(level).vertices])
