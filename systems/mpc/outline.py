"""The outline of an object at the height at which it is pushed, and how far points are from it."""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import trimesh

from pinwm_drake.errors import ParameterError

_STRAIGHT = 1e-3  # m: a corner that is this near to the line between its neighbours is none


@dataclass(frozen=True, eq=False)
class Outline:
    """A closed polygon, counter-clockwise, that need not be convex.

    Attributes:
        corners: (n, 2) m, in the plane of the floor, frame B (`PlanarBody`); edge i goes from corner i to the next.
    """

    corners: np.ndarray

    @cached_property
    def spans(self) -> np.ndarray:
        """(n, 2) m, of each edge, from its first corner to its second."""
        return np.roll(self.corners, -1, axis=0) - self.corners

    @cached_property
    def lengths(self) -> np.ndarray:
        """(n,) m, of the edges."""
        return np.hypot(*self.spans.T)

    @cached_property
    def tangents(self) -> np.ndarray:
        """(n, 2), unit, along the edges."""
        return self.spans / self.lengths[:, None]

    @cached_property
    def normals(self) -> np.ndarray:
        """(n, 2), unit, outward."""
        return np.stack([self.tangents[:, 1], -self.tangents[:, 0]], axis=1)

    @cached_property
    def convex(self) -> np.ndarray:
        """(n,) bool, of the corners: whether the object is outside of none of its sides there."""
        before = np.roll(self.tangents, 1, axis=0)
        turn = before[:, 0] * self.tangents[:, 1] - before[:, 1] * self.tangents[:, 0]
        return turn > 0

    def stretch(self, edge: int, radius: float, margin: float) -> tuple[float, float]:
        """From where to where along an edge [m] a disc of a radius [m] touches it, by a margin [m] off its ends."""
        after = (edge + 1) % len(self.corners)
        ends = [margin if self.convex[corner] else radius + margin for corner in (edge, after)]
        return ends[0], float(self.lengths[edge]) - ends[1]

    def corner_points(self, distance: float) -> np.ndarray:
        """(m, 2) m: where to go round the convex corners, at a distance [m] from both of their edges."""
        n, before = self.normals[self.convex], np.roll(self.normals, 1, axis=0)[self.convex]
        both = n + before
        # Along the bisector; of a sharp corner no farther off than twice the distance.
        reach = np.minimum(1.0 / np.maximum(np.einsum("ij,ij->i", both, n), 1e-9), 1.0)
        return self.corners[self.convex] + distance * both * reach[:, None]

    def nearest(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """How far points are from the outline, and which way is out.

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
    """The outline of a mesh at a height z [m], its frame's x and y kept.

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
    """Of a polygon, m^2; positive if counter-clockwise."""
    after = np.roll(loop, -1, axis=0)
    return 0.5 * float((loop[:, 0] * after[:, 1] - loop[:, 1] * after[:, 0]).sum())


def _simple(loop: np.ndarray) -> np.ndarray:
    """A polygon without the corners that hardly are some."""
    corners = list(loop)
    while len(corners) > 3:
        off = [_height(corners[k - 1], corners[k], corners[(k + 1) % len(corners)]) for k in range(len(corners))]
        least = int(np.argmin(off))
        if off[least] > _STRAIGHT:
            break
        del corners[least]
    return np.array(corners)


def _height(before: np.ndarray, corner: np.ndarray, after: np.ndarray) -> float:
    """How far a corner is from the line between its neighbours, m."""
    u, v = after - before, corner - before
    length = math.hypot(*u)
    return abs(float(u[0] * v[1] - u[1] * v[0])) / length if length > 0 else math.hypot(*v)
