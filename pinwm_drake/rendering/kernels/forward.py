"""Entry points of the forward pass (numba); each works on a range of views or tile rows without Python's lock."""

import numpy as np

from pinwm_drake.jit import entry_point
from pinwm_drake.rendering.kernels.bins import bin_surfels
from pinwm_drake.rendering.kernels.blend import CHANNELS, blend_tile
from pinwm_drake.rendering.kernels.columns import PIXELS, TILE
from pinwm_drake.rendering.kernels.project import project_surfels


@entry_point
def project_views(surfels, sh, view, size, splats, depths, boxes, totals, first, last):
    """Projects into views first..last-1; totals (V,) receives how long their lists are."""
    basis = np.empty(16, np.float32)
    for v in range(first, last):
        totals[v] = project_surfels(v, surfels, sh, view, size, splats, depths, boxes, basis)


@entry_point
def bin_views(size, boxes, keys, starts, entries, first, last):
    """Makes the tiles' lists of views first..last-1."""
    N = boxes.shape[1]
    order, spare, counts = np.empty(N, np.int32), np.empty(N, np.int32), np.empty(6144, np.int32)
    for v in range(first, last):
        bin_surfels(v, size, boxes, keys, starts, entries, order, spare, counts)


@entry_point
def blend_rows(splats, boxes, starts, entries, background, full, origins, images, first, last):
    """Blends tile rows first..last-1, counted through all views."""
    work = np.empty(CHANNELS * PIXELS, np.float32)
    height, width = images[1].shape[1], images[1].shape[2]
    rows, columns = (height + TILE - 1) // TILE, (width + TILE - 1) // TILE
    for i in range(first, last):
        v = i // rows
        for column in range(columns):
            blend_tile(
                v, i - v * rows, column, splats, boxes, starts, entries, background, full, origins[v], images, work
            )
