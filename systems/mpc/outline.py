# SPDX-License-Identifier: MIT
"""The outline of an object at the height at which it is pushed, and distances of points from it."""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import trimesh

from pinwm_drake.errors import ParameterError

_STRAIGHT = 1e-3  # m, distance from the line between its neighbours up to which a corner is left out


@dataclass(frozen=True, eq=False)
class Outline:
    """A closed polygon, counter-clockwise, that need not be convex.

    Attributes:
        corners: (n, 2) m, in the plane of the floor, frame B (`PlanarBody`); edge i goes from corner i to the next.
    """

    corners: np.ndarray

    @cached_property
    def spans(self) -> np.ndarray:
        """Vectors (n, 2) m from each edge's first corner to its second, frame B."""
        return np.roll(self.corners, -1, axis=0) - self.corners

    @cached_property
    def lengths(self) -> np.ndarray:
        """Lengths (n,) m of the edges."""
        return np.hypot(*self.spans.T)

    @cached_property
    def tangents(self) -> np.ndarray:
        """Unit vectors (n, 2) along the edges, frame B."""
        return self.spans / self.lengths[:, None]

    @cached_property
    def normals(self) -> np.ndarray:
        """Outward unit normals (n, 2) of the edges, frame B."""
        return np.stack([self.tangents[:, 1], -self.tangents[:, 0]], axis=1)

    @cached_property
    def convex(self) -> np.ndarray:
        """Flags (n,) bool of the convex corners, at which the outline turns to the left."""
        before = np.roll(self.tangents, 1, axis=0)
        turn = before[:, 0] * self.tangents[:, 1] - before[:, 1] * self.tangents[:, 0]
        return turn > 0

    def stretch(self, edge: int, radius: float, margin: float) -> tuple[float, float]:
        """Stretch of an edge on which a disc can touch it.

        Args:
            edge: Index of the edge.
            radius: m, radius of the disc.
            margin: m, distance that stays free at both ends.

        Returns:
            Begin and end of the stretch, m from the edge's first corner; the end may be below the begin.
        """
        after = (edge + 1) % len(self.corners)
        ends = [margin if self.convex[corner] else radius + margin for corner in (edge, after)]
        return ends[0], float(self.lengths[edge]) - ends[1]

    def corner_points(self, distance: float) -> np.ndarray:
        """Points (m, 2) m at which to go round the convex corners, frame B, at a distance [m] from both edges."""
        n, before = self.normals[self.convex], np.roll(self.normals, 1, axis=0)[self.convex]
        both = n + before
        # Along the bisector; of a sharp corner no farther off than twice the distance.
        reach = np.minimum(1.0 / np.maximum(np.einsum("ij,ij->i", both, n), 1e-9), 1.0)
        return self.corners[self.convex] + distance * both * reach[:, None]

    def nearest(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Distances of points from the outline, and directions outward.

        Args:
            points: (m, 2) m, frame B.

        Returns:
            Signed distances (m,) m, negative inside, and unit vectors (m, 2) along which they grow.
        """
        away = points[:, None] - self.corners
        along = np.einsum("mnk,nk->mn", away, self.spans) / self.lengths**2
        off = away - np.clip(along, 0.0, 1.0)[..., None] * self.spans
        squares = np.einsum("mnk,mnk->mn", off, off)
        edge = np.argmin(squares, axis=1)
        rows = np.arange(len(points))
        # Inside where a ray along x meets the outline an odd number of times.
        y, low, high = points[:, None, 1], self.corners[:, 1], np.roll(self.corners[:, 1], -1)
        crosses = (low <= y) != (high <= y)
        cut = self.corners[:, 0] + (y - low) * self.spans[:, 0] / np.where(crosses, self.spans[:, 1], 1.0)
        inside = (crosses & (cut > points[:, None, 0])).sum(axis=1) % 2 == 1
        distance = np.sqrt(squares[rows, edge])
        sign = np.where(inside, -1.0, 1.0)
        out = off[rows, edge] / np.maximum(distance, 1e-12)[:, None] * sign[:, None]
        out = np.where(distance[:, None] > 1e-9, out, self.normals[edge])
        return sign * distance, out


def slice_outline(mesh: trimesh.Trimesh, height: float) -> Outline:
    """Outline of a mesh at a height z [m], in x and y of the mesh's frame.

    Where the object is in several pieces at that height, or has holes, the outline of the largest piece.

    Raises:
        ParameterError: There is nothing of the mesh at that height.
    """
    section = mesh.section(plane_origin=[0.0, 0.0, height], plane_normal=[0.0, 0.0, 1.0])
    loops = [np.asarray(loop)[:-1, :2] for loop in section.discrete] if section is not None else []
    loops = [loop for loop in loops if len(loop) > 2 and abs(_area(loop)) > 0]
    if not loops:
        low, high = mesh.bounds[:, 2]
        raise ParameterError(f"pusher_height: got {height:g} m; allowed: within the object, {low:g} to {high:g} m")
    loop = max(loops, key=lambda found: abs(_area(found)))
    return Outline(_simple(loop if _area(loop) > 0 else loop[::-1]))


def _area(loop: np.ndarray) -> float:
    """Area [m^2] of a polygon with corners (n, 2) m; positive if counter-clockwise."""
    after = np.roll(loop, -1, axis=0)
    return 0.5 * float((loop[:, 0] * after[:, 1] - loop[:, 1] * after[:, 0]).sum())


def _simple(loop: np.ndarray) -> np.ndarray:
    """Polygon (n, 2) m without the corners that are within `_STRAIGHT` of the line between their neighbours."""
    corners = list(loop)
    while len(corners) > 3:
        off = [_height(corners[k - 1], corners[k], corners[(k + 1) % len(corners)]) for k in range(len(corners))]
        least = int(np.argmin(off))
        if off[least] > _STRAIGHT:
            break
        del corners[least]
    return np.array(corners)


def _height(before: np.ndarray, corner: np.ndarray, after: np.ndarray) -> float:
    """Distance [m] of a corner from the line between its neighbours, all (2,) m."""
    u, v = after - before, corner - before
    length = math.hypot(*u)
    return abs(float(u[0] * v[1] - u[1] * v[0])) / length if length > 0 else math.hypot(*v)
