# SPDX-License-Identifier: MIT
"""The visual hull: all points that masks of posed photos leave."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from scipy import ndimage

_NO_ROWS = np.empty(0, np.float32)  # columns and rows are in one array
_CHUNK = 30_000  # points that OpenCV samples at once; its arrays have 32,767 rows at most
_FAR = 1.0  # m, the largest distance from a surface
_UNSEEN = 50.0  # px: what lies beyond a photo is no business of its mask


@dataclass(frozen=True, eq=False)
class Grid:
    """Points of a box with its edges along the axes of the world.

    Attributes:
        low: (3,) m, the first point.
        voxel: m, between neighbours.
        shape: Numbers of points along x, y, z.
    """

    low: np.ndarray
    voxel: float
    shape: tuple[int, int, int]

    @staticmethod
    def between(low: np.ndarray, high: np.ndarray, voxel: float) -> "Grid":
        """Grid from one corner (3,) to the other (3,) [m]."""
        x, y, z = (int(n) for n in np.maximum(np.ceil((high - low) / voxel), 0) + 1)
        return Grid(np.array(low, float), voxel, (x, y, z))

    def points(self) -> np.ndarray:
        """Return the points (n, 3) float32 [m]."""
        axes = [self.low[k] + self.voxel * np.arange(self.shape[k]) for k in range(3)]
        return np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3).astype(np.float32)

    def level_above(self, height: float) -> int:
        """Index along z of the first points that are a voxel or more over a height [m]."""
        return int(np.ceil((height - self.low[2]) / self.voxel + 1.0))


def focal_length(P: np.ndarray) -> float:
    """Focal length [px] of a projection (3, 4) P = K [R | t], where the last row of K is (0, 0, 1)."""
    return float(np.sqrt(abs(np.linalg.det(P[:, :3]))))


def projected(points: np.ndarray, P: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where a photo shows points: column and row (n, 2) [px], (0, 0) behind the camera, and depths (n,) [m].

    Args:
        points: (n, 3) float32 m, world.
        P: (3, 4), projection.
    """
    uvz = points @ P[:, :3].T.astype(np.float32) + P[:, 3].astype(np.float32)
    depth = uvz[:, 2]
    return (uvz[:, :2] / np.where(depth > 0, depth, np.inf)[:, None]).astype(np.float32), depth


def sampled(picture: np.ndarray, P: np.ndarray, points: np.ndarray, outside: float) -> tuple[np.ndarray, np.ndarray]:
    """Values (n,) of a picture (H, W) float32 where points are seen, and their depths (n,) [m].

    Args:
        picture: Whole numbers of columns and rows are the middles of its pixels.
        P: (3, 4), projection.
        points: (n, 3) m, world.
        outside: Value beyond the picture and behind the camera.
    """
    at, depth = projected(points, P)
    values = [
        cv2.remap(picture, at[k : k + _CHUNK, None], _NO_ROWS, cv2.INTER_LINEAR, borderValue=outside)[:, 0]
        for k in range(0, len(at), _CHUNK)
    ]
    return np.where(depth > 0, np.concatenate(values), np.float32(outside)), depth


def signed_distance(mask: np.ndarray) -> np.ndarray:
    """Distances (H, W) float32 [px] from the outline of a mask (H, W) bool, positive inside."""
    inside, outside = (cv2.distanceTransform(part.astype(np.uint8), cv2.DIST_L2, 5) for part in (mask, ~mask))
    if not mask.any():
        return np.full(mask.shape, -_UNSEEN, np.float32)
    return np.where(mask, inside - 0.5, 0.5 - outside).astype(np.float32)


def carve(
    masks: Sequence[np.ndarray], projections: Sequence[np.ndarray], grid: Grid, misses: int, least_seen: float = 0.6
) -> np.ndarray:
    """Flags (grid.shape) of the points that all masks but a few show.

    Args:
        masks: (H, W) bool each, or float32 with 0, 1, and -1 where nothing is known.
        projections: (3, 4) each, of the photo of the mask.
        grid: The points.
        misses: Number of photos that may not show a point which lies in their frame.
        least_seen: Share of the photos that have to have a point in their frame.
    """
    points = grid.points()
    votes, seen = np.zeros(len(points), np.int16), np.zeros(len(points), np.int16)
    for mask, P in zip(masks, projections, strict=True):
        value, _ = sampled(mask.astype(np.float32), P, points, -1.0)
        seen += value >= 0
        votes += value > 0.5
    return ((votes >= seen - misses) & (seen >= least_seen * len(masks))).reshape(grid.shape)


def parts(flags: np.ndarray, *, corners: bool = True) -> tuple[np.ndarray, np.ndarray]:
    """Numbers (shape of `flags`) of connected parts, from 1, and the number of points in each (k,).

    Points are connected along the axes and, where `corners` says so, along all diagonals.
    """
    labels, _ = ndimage.label(flags, np.ones((3, 3, 3)) if corners else None)
    return labels, np.bincount(labels.ravel())[1:]


def hull_depths(
    distances: Sequence[np.ndarray], projections: Sequence[np.ndarray], points: np.ndarray, most: float
) -> np.ndarray:
    """Distances (n,) float32 [m] of points from the surface of the hull, positive inside.

    One mask alone takes off no more than `most` of what the others leave: a corner may be seen in one photo only, and a
    mask may be wrong.

    Args:
        distances: Signed distances (H, W) [px] of the masks; see `signed_distance`.
        projections: (3, 4) each.
        points: (n, 3) m, world.
        most: m, that one mask alone takes off.
    """
    layers = np.empty((len(distances), len(points)), np.float32)
    for k, (picture, P) in enumerate(zip(distances, projections, strict=True)):
        value, depth = sampled(picture, P, points, _UNSEEN)
        focal = np.linalg.norm(P[0, :3] - P[2, :3] * (P[0, :3] @ P[2, :3]))
        layers[k] = np.where(depth > 0, value * depth / focal, np.inf)  # what is behind a camera it says nothing of
    if len(layers) == 1:
        return np.minimum(layers[0], np.float32(_FAR))
    least, second = np.partition(layers, 1, axis=0)[:2]
    return np.minimum(np.maximum(least, second - np.float32(most)), np.float32(_FAR))
