# SPDX-License-Identifier: MIT
"""Entry points of the forward pass (numba); each works on a range of views or tile rows without Python's lock."""

import numpy as np

from pinwm_drake.jit import entry_point
from pinwm_drake.rendering.kernels.bins import RADIX, bin_surfels
from pinwm_drake.rendering.kernels.blend import CHANNELS, X, Y, blend_tile, fill_places
from pinwm_drake.rendering.kernels.columns import COLUMNS, PIXELS, TILE
from pinwm_drake.rendering.kernels.project import BLOCK, prepare_surfels, project_surfels, rotation_columns
from pinwm_drake.rendering.kernels.project import CHANNELS as PROJECT_CHANNELS


@entry_point
def fill_rotations(q, R):
    """Write rotations R (V, 3, 3) of quaternions q (V, 4), wxyz, of any length."""
    for v in range(q.shape[0]):
        columns = rotation_columns(q[v, 0], q[v, 1], q[v, 2], q[v, 3])
        for i in range(3):
            for j in range(3):
                R[v, i, j] = columns[3 * j + i]


@entry_point
def prepare(surfels, same):
    """Find what is the same in all views; see `prepare_surfels`."""
    prepare_surfels(surfels, same)


@entry_point
def project_views(same, sh, view, size, splats, depths, boxes, totals, first, last):
    """Projects surfels into views first..last-1; totals (V,) receives the lengths of their lists."""
    basis, work = np.empty(16, np.float32), np.empty((PROJECT_CHANNELS, BLOCK), np.float32)
    for v in range(first, last):
        totals[v] = project_surfels(v, v, same, sh, view, size, True, splats, depths, boxes, basis, work)


@entry_point
def bin_views(size, boxes, keys, starts, entries, first, last):
    """Make the tiles' lists of views first..last-1."""
    N = boxes.shape[1]
    order, spare, counts = np.empty(N, np.int32), np.empty(N, np.int32), np.empty(RADIX, np.int32)
    for v in range(first, last):
        bin_surfels(v, size, boxes, keys, starts, entries, order, spare, counts)


@entry_point
def blend_rows(scene, steepness, origins, images, first, last):
    """Blends tile rows first..last-1, counted through all views; `scene` and `images` as in `blend.blend_tile`."""
    work = np.empty(CHANNELS * PIXELS, np.float32)
    fill_places(work, X, Y)
    height, width = images[1].shape[1], images[1].shape[2]
    rows, columns = (height + TILE - 1) // TILE, (width + TILE - 1) // TILE
    for i in range(first, last):
        v = i // rows
        for column in range(columns):
            blend_tile(v, v, i - v * rows, column, scene, steepness[v], origins[v], images, work)


@entry_point
def render_views(same, sh, view, size, background, full, images, first, last):
    """Render views first..last-1 from end to end and keep nothing but their images: work of one view at a time."""
    N = sh.shape[1]
    rows, columns = (size[0] + TILE - 1) // TILE, (size[1] + TILE - 1) // TILE
    basis, work = np.empty(16, np.float32), np.empty((PROJECT_CHANNELS, BLOCK), np.float32)
    tile_work = np.empty(CHANNELS * PIXELS, np.float32)
    fill_places(tile_work, X, Y)
    splats, depths = np.empty((1, N, COLUMNS), np.float32), np.empty((1, N), np.float32)
    boxes = np.empty((1, N, 5), np.int32)
    order, spare, counts = np.empty(N, np.int32), np.empty(N, np.int32), np.empty(RADIX, np.int32)
    starts = np.zeros((1, rows * columns + 1), np.int64)
    keys = depths.view(np.int32)
    for v in range(first, last):
        total = project_surfels(v, 0, same, sh, view, size, full, splats, depths, boxes, basis, work)
        entries = np.empty(total, np.int32)
        bin_surfels(0, size, boxes, keys, starts, entries, order, spare, counts)
        scene = (splats, boxes, starts, entries, background, full)
        for row in range(rows):
            for column in range(columns):
                blend_tile(v, 0, row, column, scene, view[3][v], view[1][v, 2], images, tile_work)
