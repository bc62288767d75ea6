# SPDX-License-Identifier: MIT
"""Flat patches on the surface of a mesh: where surfels start."""

from collections.abc import Callable
from dataclasses import dataclass, fields

import numpy as np
import trimesh
from scipy.spatial import cKDTree

# Faces meet in a crease where they turn by more than this, rad.
_CREASE = np.deg2rad(30.0)

# Along each side of a crease: (inset, scale across) of its rows of patches, in pixels of a typical view.
_ROWS = ((0.8, 0.6), (2.5, 1.2))

# Scales in units of the distance of neighbours, at which they cover the surface without a gap: those in a row, evenly
# spread ones, and random ones.
_ROW, EVEN, _RANDOM = 0.6, 0.9, 1.2

# The most of the distance to a crease that a scale may be.
_INSIDE = 0.5


@dataclass(frozen=True, eq=False)
class Patches:
    """n flat ellipses on a surface, in the mesh's frame O."""

    points: np.ndarray  # (n, 3), centres, m
    normals: np.ndarray  # (n, 3), unit, outwards
    tangents: np.ndarray  # (n, 3), unit, along the first scale
    scales: np.ndarray  # (n, 2), m

    @property
    def number(self) -> int:
        """Number of patches n."""
        return len(self.points)

    def select(self, chosen: np.ndarray) -> "Patches":
        """Subset of the patches that a mask (n,) bool or indices (k,) int choose."""
        return Patches(*(getattr(self, item.name)[chosen] for item in fields(self)))

    @staticmethod
    def join(*parts: "Patches") -> "Patches":
        """Patches of several parts in one, in the order of the parts."""
        return Patches(*(np.concatenate([getattr(part, item.name) for part in parts]) for item in fields(Patches)))

    @staticmethod
    def none() -> "Patches":
        """Empty set of patches."""
        return Patches(*(np.zeros((0, k)) for k in (3, 3, 3, 2)))


def crease_ends(mesh: trimesh.Trimesh) -> tuple[np.ndarray, np.ndarray]:
    """End (n, 2, 3) [m] of the edges at which faces meet at an angle, and the two faces (n, 2) at each."""
    sharp = mesh.face_adjacency_angles > _CREASE
    ends = np.asarray(mesh.vertices)[mesh.face_adjacency_edges[sharp]]
    return ends.reshape(-1, 2, 3), mesh.face_adjacency[sharp].reshape(-1, 2)  # one face has no neighbours at all


def spread(mesh: trimesh.Trimesh, number: int, generator: np.random.Generator) -> Patches:
    """Return `number` samples of the whole surface, stratified over its area so that each face gets its share."""
    ends = np.cumsum(mesh.area_faces)
    at = (np.arange(number) + generator.random(number)) * (ends[-1] / number)
    faces = np.minimum(np.searchsorted(ends, at), len(ends) - 1)
    u, v = generator.random((2, number, 1))
    u, v = np.where(u + v > 1.0, 1.0 - u, u), np.where(u + v > 1.0, 1.0 - v, v)
    a, b, c = np.moveaxis(np.asarray(mesh.triangles)[faces], 1, 0)
    tangents = (b - a) / np.maximum(np.linalg.norm(b - a, axis=1, keepdims=True), 1e-12)
    scales = np.full((number, 2), _RANDOM * np.sqrt(ends[-1] / number))
    return Patches(a + u * (b - a) + v * (c - a), np.asarray(mesh.face_normals)[faces], tangents, scales)


def line_creases(mesh: trimesh.Trimesh, pixel: float, number: int, seen: Callable[[Patches], np.ndarray]) -> Patches:
    """Seen patches in rows along both sides of the mesh's creases: long, narrow, just inside the faces' borders.

    Args:
        mesh: surface in O, m.
        pixel: size of a typical view's pixel on the object, m.
        number: number of patches, about; they lie at least half a pixel apart.
        seen: tells of patches (n) which are seen, (n,) bool.

    Returns:
        The patches; none for a mesh without creases.
    """
    ends, faces = crease_ends(mesh)
    lengths = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    if number == 0 or not lengths.sum() > 0.0:
        return Patches.none()
    starts = np.concatenate([[0.0], np.cumsum(lengths)])

    def rows(step: float) -> Patches:
        at = np.arange(0.5 * step, starts[-1], step)
        edge = np.clip(np.searchsorted(starts, at, side="right") - 1, 0, len(lengths) - 1)
        along = (ends[edge, 1] - ends[edge, 0]) / lengths[edge, None]
        on_edge = ends[edge, 0] + (at - starts[edge])[:, None] * along
        parts = []
        for side in range(2):
            face = faces[edge, side]
            normals = np.asarray(mesh.face_normals)[face]
            inward = np.cross(normals, along)
            # The face lies on one side of its edge.
            inward *= np.sign(np.sum(inward * (mesh.triangles_center[face] - on_edge), 1))[:, None]
            # Where an edge is long its ends are corners.
            to_end = np.minimum(at - starts[edge], starts[edge + 1] - at)
            most = np.where(lengths[edge] > 4.0 * step, np.maximum(_ROW * to_end, 0.1 * step), np.inf)
            for inset, scale in _ROWS:
                scales = np.stack([np.minimum(_ROW * step, most), np.full(len(at), scale * pixel)], 1)
                parts.append(Patches(on_edge + inset * pixel * inward, normals, along, scales))
        return Patches.join(*parts)

    # How much of the creases is seen decides the step.
    probe = float(starts[-1]) / max(number, 100)
    count = int(seen(rows(probe)).sum())
    if count == 0:
        return Patches.none()
    patches = rows(max(probe * count / number, 0.5 * pixel))
    return patches.select(seen(patches))


def keep_inside(patches: Patches, mesh: trimesh.Trimesh) -> None:
    """Shrinks patches that would hang over a crease: half of their distance to it is the most for their scales."""
    distance = np.full(patches.number, np.inf)
    for a, b in crease_ends(mesh)[0]:
        share = np.clip((patches.points - a) @ (b - a) / max(np.sum((b - a) ** 2), 1e-18), 0.0, 1.0)
        distance = np.minimum(distance, np.linalg.norm(patches.points - a - share[:, None] * (b - a), axis=1))
    np.minimum(patches.scales, np.maximum(_INSIDE * distance[:, None], 1e-6), out=patches.scales)


def farthest(points: np.ndarray, taken: np.ndarray, number: int) -> tuple[np.ndarray, float]:
    """Evenly spread points: each is the farthest from those before it.

    Args:
        points: (n, 3), m, to choose from.
        taken: (k, 3), m, points that are already there.
        number: number of points to choose, at most n.

    Returns:
        (number,), indices in the order of choice; the distance of the last one to its nearest neighbour, m.
    """
    gaps = cKDTree(taken).query(points)[0] if len(taken) else np.full(len(points), np.inf)
    chosen = np.empty(number, int)
    gap = 0.0
    x, y, z = np.ascontiguousarray(points.T)
    for i in range(number):
        k = chosen[i] = int(np.argmax(gaps))
        gap = float(gaps[k])
        gaps = np.minimum(gaps, np.sqrt((x - x[k]) ** 2 + (y - y[k]) ** 2 + (z - z[k]) ** 2))
    return chosen, gap
