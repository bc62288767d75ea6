# SPDX-License-Identifier: MIT
"""Jug with a handle as a scanner sees it: a surface net of 5 mm, uneven by 0.3 mm, and its convex pieces."""

from itertools import pairwise

import numpy as np
import trimesh

from benchmarks.next_push.surface_net import surface_net

_HEIGHT, _SPACING = 0.095, 0.005  # m
_FLOOR_OF_CAVITY, _CUT, _WALL = 0.066, 0.0695, 0.010  # m; what is above the cut is wall all over
_RING, _TUBE, _RING_HEIGHT = 0.025, 0.008, 0.050  # m, of the handle
_SHIFT = np.array([0.012, -0.007, 0.0])  # m, of the axis from the origin
_UNEVEN, _UNEVEN_BASE = 3e-4, 4e-5  # m, root of the mean square
_WAVES, _LENGTHS = 24, (0.014, 0.040)  # m
_SECTORS, _LINKS = 12, 8


def scanned_jug() -> tuple[np.ndarray, np.ndarray]:
    """Corners (n, 3) m and triangles (m, 3) of the jug, frame O; it stands on z = 0, its handle towards x."""
    low = np.array([-0.0531, -0.0532, -0.0123])
    grid = np.stack(np.meshgrid(*(low[k] + _SPACING * np.arange(n) for k, n in enumerate((29, 22, 25))), indexing="ij"))
    corners, triangles = surface_net(_field(*grid), _SPACING, low)
    mesh = trimesh.Trimesh(corners, triangles, process=False)
    generator = np.random.default_rng(20)
    uneven = _noise(corners, generator)
    share = np.where(corners[:, 2] < 1e-3, _UNEVEN_BASE, _UNEVEN)
    corners = corners + (share * uneven)[:, None] * mesh.vertex_normals
    return corners + _SHIFT, triangles


def jug_pieces(corners: np.ndarray, triangles: np.ndarray) -> list[np.ndarray]:
    """Convex pieces of the jug, each as the points (n, 3) m, frame O, whose hull it is.

    The body is cut into slabs, the wall around the cavity into sectors, the handle into links.
    """
    mesh = trimesh.Trimesh(corners - _SHIFT, triangles, process=False)
    outermost = _radius(np.linspace(0, _HEIGHT, 50)).max()
    body, handle = _part(mesh, [outermost, 0, 0], [-1, 0, 0]), _part(mesh, [outermost - 1e-3, 0, 0], [1, 0, 0])
    levels = np.linspace(-0.01, _CUT, 4)
    parts = [_slab(body, a, b) for a, b in pairwise(levels)]
    wall = _part(body, [0, 0, _CUT], [0, 0, 1])
    parts += [_sector(wall, k, _SECTORS, np.zeros(3), 2) for k in range(_SECTORS)]
    middle = np.array([_ring_middle(), 0.0, _RING_HEIGHT])
    parts += [_sector(handle, k, 2 * _LINKS, middle, 1) for k in range(2 * _LINKS)]
    return [part.vertices + _SHIFT for part in parts if len(part.faces) and np.ptp(part.vertices, axis=0).min() > 1e-3]


def _radius(z: np.ndarray) -> np.ndarray:
    """Outer radius [m] at a height [m]: a belly, and a waist towards the rim."""
    return 0.034 + 0.0045 * np.sin(2 * np.pi * (z / 0.13 - 0.08))


def _ring_middle() -> float:
    return float(_radius(np.array(_RING_HEIGHT))) + 0.001


def _field(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Signed distance [m], roughly, from the jug."""
    radial = np.hypot(x, y)
    side = radial - _radius(z)
    outer = np.maximum(np.maximum(side, z - _HEIGHT), -z)
    ring = np.hypot(np.hypot(x - _ring_middle(), 1.15 * (z - _RING_HEIGHT)) - _RING, y) - _TUBE
    # The handle ends within the wall.
    whole = np.minimum(outer, np.maximum(ring, -(side + 0.006)))
    return np.maximum(whole, -np.maximum(side + _WALL, _FLOOR_OF_CAVITY - z))


def _noise(points: np.ndarray, generator: np.random.Generator) -> np.ndarray:
    """Smooth noise (n,) of mean square 1 at points (n, 3) m."""
    directions = generator.normal(size=(_WAVES, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    lengths = generator.uniform(*_LENGTHS, _WAVES)
    phases = generator.uniform(0, 2 * np.pi, _WAVES)
    waves = np.sin(2 * np.pi * points @ (directions / lengths[:, None]).T + phases)
    return waves.sum(axis=1) / np.sqrt(0.5 * _WAVES)


def _part(mesh: trimesh.Trimesh, point: list[float] | np.ndarray, normal: list[float] | np.ndarray) -> trimesh.Trimesh:
    """Part of a surface on the side of a plane that the normal points to; empty where there is none."""
    if not len(mesh.faces):
        return mesh
    vertices, faces = trimesh.intersections.slice_faces_plane(mesh.vertices, mesh.faces, normal, point)[:2]
    return trimesh.Trimesh(vertices, faces, process=False)


def _slab(mesh: trimesh.Trimesh, low: float, high: float) -> trimesh.Trimesh:
    return _part(_part(mesh, [0, 0, low], [0, 0, 1]), [0, 0, high], [0, 0, -1])


def _sector(mesh: trimesh.Trimesh, k: int, count: int, middle: np.ndarray, axis: int) -> trimesh.Trimesh:
    """Part of a surface between two half-planes from an axis through a point."""
    u, v = np.eye(3)[(axis + 1) % 3], np.eye(3)[(axis + 2) % 3]
    for angle, sign in ((2 * np.pi * k / count, 1), (2 * np.pi * (k + 1) / count, -1)):
        mesh = _part(mesh, middle, sign * (np.cos(angle) * v - np.sin(angle) * u))
    return mesh
