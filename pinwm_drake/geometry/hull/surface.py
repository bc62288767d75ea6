# SPDX-License-Identifier: MIT
"""Closed meshes from fields of signed distances: the hull of masks, and depths fused within it."""

from collections.abc import Sequence

import manifold3d
import numpy as np
import trimesh
from scipy import ndimage

from pinwm_drake.geometry.hull.prism import upright
from pinwm_drake.geometry.hull.repair import as_mesh, simplified
from pinwm_drake.geometry.hull.sides import cleared
from pinwm_drake.geometry.hull.top import flattened
from pinwm_drake.geometry.hull.visual import Grid, hull_depths, sampled, signed_distance

UPRIGHT = "upright"  # key of `metadata` of a mesh that was taken for a prism
_VOXELS = 70  # along the largest extent of the object
_ALONE = 1.0  # voxels that one mask alone takes off
_ROOM = 2  # voxels of the coarse hull around its points
_BAND = 3.3  # voxels around a surface in which depths count
_MARGIN = 1.0  # voxels, of a hull around depths
_CRUMB = 1e-3  # of the largest piece: less is noise of the size of voxels
_SMOOTH = 0.7  # voxels, of the noise of depths


def hull_meshes(
    masks: Sequence[np.ndarray],
    projections: Sequence[np.ndarray],
    points: np.ndarray,
    coarse: float,
    floor: float,
    depths: Sequence[np.ndarray] | None = None,
) -> list[trimesh.Trimesh]:
    """Closed meshes [m, world] of the pieces that masks leave, cut off at the table, the largest first.

    The hull fills cups; its top is as flat, and hollows of its plan are as clear, as the outlines allow. Depths carve
    what it fills. A hull with upright sides and a level top is one prism, and its metadata say so.

    Args:
        masks: (H, W) bool each.
        projections: (3, 4) each.
        points: (n, 3) m: points of a coarse hull.
        coarse: m, between them.
        floor: Height of the table, m, world.
        depths: (H, W) float32 each, m along the camera's axis, 0 where nothing is known; or None.
    """
    if not len(points):
        return []
    low, high = points.min(axis=0) - _ROOM * coarse, points.max(axis=0) + _ROOM * coarse
    voxel = float((high - low).max()) / _VOXELS
    low[2] = floor - voxel
    grid = Grid.between(low, high, voxel)
    places = grid.points()
    distances = [signed_distance(mask) for mask in masks]
    field = hull_depths(distances, projections, places, _ALONE * voxel)
    made = None
    if depths is None:
        field = flattened(field.reshape(grid.shape), grid, distances, projections)
        field = cleared(field, grid, floor, distances, projections)
        made = upright(field, grid, floor, projections)
    else:
        # Outlines waver, and the least of many is too small: where depths tell, they do.
        field = np.minimum(field + _MARGIN * voxel, _fused(depths, projections, places, _BAND * voxel))
    is_prism = made is not None
    if made is None:
        values = field.reshape(grid.shape)
        values = ndimage.gaussian_filter(values, _SMOOTH) if depths is not None else values
        made = _surface(values, grid).trim_by_plane([0.0, 0.0, 1.0], floor)
    pieces = sorted(made.decompose(), key=lambda piece: -piece.volume())
    meshes = [as_mesh(simplified(piece)) for piece in pieces if piece.volume() > _CRUMB * pieces[0].volume()]
    for mesh in meshes if is_prism else ():
        mesh.metadata[UPRIGHT] = True
    return meshes


def _surface(values: np.ndarray, grid: Grid) -> manifold3d.Manifold:
    """Surface where values (nx, ny, nz) at the points of a grid change their sign, linear in between."""
    nx, ny, nz = grid.shape
    flat, ystep, xstep = values.ravel().tolist(), nz, ny * nz
    x0, y0, z0 = grid.low.tolist()
    scale = 1.0 / grid.voxel

    def value(x: float, y: float, z: float) -> float:
        u, v, w = (x - x0) * scale, (y - y0) * scale, (z - z0) * scale
        i, j, k = int(u), int(v), int(w)
        i, j, k = min(max(i, 0), nx - 2), min(max(j, 0), ny - 2), min(max(k, 0), nz - 2)
        a, b, c = u - i, v - j, w - k
        n = i * xstep + j * ystep + k
        p = flat[n] + c * (flat[n + 1] - flat[n])
        q = flat[n + ystep] + c * (flat[n + ystep + 1] - flat[n + ystep])
        n += xstep
        r = flat[n] + c * (flat[n + 1] - flat[n])
        s = flat[n + ystep] + c * (flat[n + ystep + 1] - flat[n + ystep])
        p += b * (q - p)
        r += b * (s - r)
        return p + a * (r - p)

    high = grid.low + grid.voxel * (np.array(grid.shape) - 1)
    return manifold3d.Manifold.level_set(value, [*grid.low.tolist(), *high.tolist()], 1.5 * grid.voxel)


def _fused(
    depths: Sequence[np.ndarray], projections: Sequence[np.ndarray], points: np.ndarray, band: float
) -> np.ndarray:
    """Distances (n,) [m] of points from the surface that depths show, positive inside, within a band.

    Pixels beside a jump of more than two bands do not count: they mix what is before with what is behind.

    Source: Curless and Levoy, "A volumetric method for building complex models from range images" (1996).
    """
    total, number = np.zeros(len(points), np.float32), np.zeros(len(points), np.float32)
    for picture, P in zip(depths, projections, strict=True):
        nearest, farthest = (filtered(picture, 3) for filtered in (ndimage.minimum_filter, ndimage.maximum_filter))
        known = (nearest > 0) & (farthest - nearest < 2.0 * band)
        seen, _ = sampled(known.astype(np.float32), P, points, 0.0)
        value, depth = sampled(picture.astype(np.float32), P, points, 0.0)
        behind = depth - value
        counts = (seen > 0.999) & (behind < band)
        total[counts] += np.maximum(behind[counts], -band)
        number[counts] += 1
    return np.where(number > 0, total / np.maximum(number, 1), band)
