# SPDX-License-Identifier: MIT
"""The top of a visual hull: as low and as flat as the outlines of the masks allow.

Photos from above leave a dome on a flat top, w tan(e) high for a half width w and the lowest elevation e. Each ray just
inside an outline meets the object, at the latest where it leaves the hull. Half spaces that hold these points bound the
least object with a convex top that has the same outlines.
"""

from collections.abc import Sequence

import numpy as np
from scipy import ndimage

from pinwm_drake.geometry.hull.visual import Grid, focal_length

_INSIDE = (0.25, 1.75)  # px from an outline: where its rays are
_SLACK = 1.0  # voxels around the hull that count as hull: outlines waver, and corners are lost
_STEP = 0.5  # voxels, along a ray
_LENGTH = 1.5  # voxels, of an outline that asks for a height: less is noise
_DISTRUST = 10  # one photo of so many may ask for too much
_DIRECTIONS, _LOWEST = 400, 0.15  # normals of half spaces; the least upward part of one


def flattened(
    values: np.ndarray, grid: Grid, distances: Sequence[np.ndarray], projections: Sequence[np.ndarray]
) -> np.ndarray:
    """Distances (grid.shape) float32 [m] from the surface of a hull without what its outlines do not need above.

    A dome that no photo shows from the side becomes too flat.

    Args:
        values: (grid.shape) m, distances from the surface of the hull, positive inside.
        grid: Its points.
        distances: Signed distances (H, W) [px] of the masks; see `visual.signed_distance`.
        projections: (3, 4) each, of the photo of the mask.
    """
    normals, reaches = _upward(_DIRECTIONS), []
    for picture, P in zip(distances, projections, strict=True):
        exits, pixel = _exits(values, grid, picture, P)
        if len(exits):
            number = round(_LENGTH * grid.voxel / pixel * (_INSIDE[1] - _INSIDE[0]))
            kth = len(exits) - min(max(number, 1), len(exits))
            reaches.append(np.partition(exits @ normals.T, kth, axis=0)[kth])
    if not reaches:
        return values
    trusted = max(len(reaches) - 1 - len(projections) // _DISTRUST, 0)
    bounds = np.sort(np.array(reaches, np.float32), axis=0)[trusted]
    points, least = grid.points(), values.reshape(-1).astype(np.float32)
    for normal, bound in zip(normals.astype(np.float32), bounds, strict=True):
        np.minimum(least, bound - points @ normal, out=least)
    return least.reshape(grid.shape)


def _exits(values: np.ndarray, grid: Grid, picture: np.ndarray, P: np.ndarray) -> tuple[np.ndarray, float]:
    """Points (n, 3) [m, world] where rays inside an outline leave the hull, and the size of a pixel there [m]."""
    rows, columns = np.nonzero((picture > _INSIDE[0]) & (picture <= _INSIDE[1]))
    eye = -np.linalg.solve(P[:, :3], P[:, 3])
    rays = np.linalg.solve(P[:, :3], np.stack([columns, rows, np.ones(len(rows))])).T
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    rays[rays == 0.0] = np.finfo(float).tiny
    corners = np.stack([grid.low, grid.low + grid.voxel * (np.array(grid.shape) - 1)])
    crossings = (corners[:, None] - eye) / rays
    near, far = crossings.min(axis=0).max(axis=1), crossings.max(axis=0).min(axis=1)
    through = (far > near) & (near > 0.0)
    if not through.any():
        return np.empty((0, 3)), 0.0
    rays, near, far = rays[through, None], near[through, None], far[through, None]
    share = np.linspace(0.0, 1.0, 1 + int(np.ceil((far - near).max() / (_STEP * grid.voxel))))
    points = eye + (near + (far - near) * share)[..., None] * rays
    at = ((points - grid.low) / grid.voxel).reshape(-1, 3).T
    within = ndimage.map_coordinates(values, at, order=1, mode="nearest") > -_SLACK * grid.voxel
    within = within.reshape(points.shape[:2])
    met = np.flatnonzero(within.any(axis=1))
    last = len(share) - 1 - np.argmax(within[met, ::-1], axis=1)
    return points[met, last], float(np.median(near)) / focal_length(P)


def _upward(number: int) -> np.ndarray:
    """Unit vectors (number + 1, 3), even over the directions upwards; the first is straight up."""
    rank = np.arange(number) + 0.5
    z = 1.0 - (1.0 - _LOWEST) * rank / number
    angle, r = np.pi * (1.0 + np.sqrt(5.0)) * rank, np.sqrt(1.0 - z * z)
    return np.vstack([[0.0, 0.0, 1.0], np.column_stack([r * np.cos(angle), r * np.sin(angle), z])])
