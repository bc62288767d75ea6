# SPDX-License-Identifier: MIT
"""The sides of a visual hull: without what fills a hollow of its outline as seen from above.

A ray into an inner corner of height h meets the table or the other wall: photos with the elevation e leave up to
h / (2 tan(e)) of it filled, half-way up. At the table and at the top the corner is clear. What stands in a column that
is empty at both heights, between parts of the object that stand there, is taken off where no outline needs it.
"""

from collections.abc import Sequence

import cv2
import numpy as np

from pinwm_drake.geometry.hull.visual import Grid, focal_length, projected

_NEEDED = 2  # photos that show a point where nothing else is: one mask alone may be wrong


def cleared(
    values: np.ndarray, grid: Grid, floor: float, distances: Sequence[np.ndarray], projections: Sequence[np.ndarray]
) -> np.ndarray:
    """Distances (grid.shape) float32 [m] from the surface of a hull whose hollows in plan view are as at foot and top.

    Args:
        values: (grid.shape) m, distances from the surface of the hull, positive inside.
        grid: Its points.
        floor: Height of the table, m, world.
        distances: Signed distances (H, W) [px] of the masks; see `visual.signed_distance`.
        projections: (3, 4) each, of the photo of the mask.
    """
    inside = values > 0.0
    levels = np.flatnonzero(inside.any(axis=(0, 1)))
    foot = grid.level_above(floor)
    if not len(levels) or levels[-1] <= foot:
        return values
    ends = values[:, :, foot], values[:, :, levels[-1]]
    clear = np.maximum(*ends)
    hollow = (clear < 0.0) & _spanned(ends[0] > 0.0) & _spanned(ends[1] > 0.0)
    made = np.where(hollow[:, :, None], np.minimum(values, clear[:, :, None]), values)
    taken = inside & (made <= 0.0)
    if taken.any():
        needed = taken.copy()
        needed[taken] = _needed(grid, made > 0.0, taken, distances, projections)
        made[needed] = values[needed]
    return made


def _spanned(flags: np.ndarray) -> np.ndarray:
    """Flags (nx, ny) of the points within the convex hull of those that are set."""
    span = np.zeros(flags.shape, np.uint8)
    points = np.argwhere(flags)[:, ::-1].astype(np.int32)  # as OpenCV has them: columns first
    if len(points):
        cv2.fillConvexPoly(span, cv2.convexHull(points), 1)
    return span.astype(bool)


def _needed(
    grid: Grid, kept: np.ndarray, taken: np.ndarray, distances: Sequence[np.ndarray], projections: Sequence[np.ndarray]
) -> np.ndarray:
    """Flags of the points that were taken off and that several masks show where no point that is kept is seen."""
    points = grid.points()
    there, gone = points[kept.ravel()], points[taken.ravel()]
    shown = np.zeros(len(gone), int)
    for picture, P in zip(distances, projections, strict=True):
        _, columns, rows, depth = _shown(there, P, picture.shape)
        if not len(depth):
            continue  # it looks away
        size = int(np.ceil(grid.voxel * focal_length(P) / np.median(depth)))  # px, of a voxel
        seen = np.zeros(picture.shape, np.uint8)
        seen[rows, columns] = 1
        bare = (picture > size) & (cv2.dilate(seen, np.ones((2 * size + 1,) * 2, np.uint8)) == 0)
        at, columns, rows, _ = _shown(gone, P, picture.shape)
        shown[at] += bare[rows, columns]
    return shown >= min(_NEEDED, len(distances))


def _shown(
    points: np.ndarray, P: np.ndarray, shape: tuple[int, ...]
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Numbers, columns, rows and depths [m] of the points (n, 3) [m, world] that a picture (H, W) shows."""
    at, depth = projected(points, P)
    pixels = np.rint(at).astype(int)
    numbers = np.flatnonzero(((pixels >= 0) & (pixels < shape[::-1])).all(axis=1) & (depth > 0))
    columns, rows = pixels[numbers].T
    return numbers, columns, rows, depth[numbers]
