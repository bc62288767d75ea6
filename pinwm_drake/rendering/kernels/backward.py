# SPDX-License-Identifier: MIT
"""Entry points of the backward pass (numba); each works on a range without Python's lock."""

import numpy as np

from pinwm_drake.jit import entry_point
from pinwm_drake.rendering.kernels.blend import fill_places
from pinwm_drake.rendering.kernels.blend_adjoint import CHANNELS, X, Y, pull_tile
from pinwm_drake.rendering.kernels.columns import PIXELS, TILE
from pinwm_drake.rendering.kernels.project_adjoint import pull_surfel, quaternion_gradient


@entry_point
def pull_rows(scene, steepness, origins, images, image_bars, bars, bands, first, last):
    """Pull the gradients of bands first..last-1 of tile rows back to the projected surfels.

    Args:
        scene, steepness, origins, images: as in `forward.blend_rows`.
        image_bars: gradients with respect to the images.
        bars: (parts, V, N, 16), receives sums.
        bands: (bands, 3): part, first and last-plus-one tile row counted through all views; bands that share a
            view have different parts.
        first, last: range of bands.
    """
    work = np.empty(CHANNELS * PIXELS, np.float32)
    fill_places(work, X, Y)
    height, width = images[1].shape[1], images[1].shape[2]
    rows, columns = (height + TILE - 1) // TILE, (width + TILE - 1) // TILE
    for band in range(first, last):
        part = bands[band, 0]
        for i in range(bands[band, 1], bands[band, 2]):
            v = i // rows
            for column in range(columns):
                row = i - v * rows
                pull_tile(v, row, column, scene, steepness[v], origins[v], images, image_bars, bars, part, work)


@entry_point
def pull_surfels(surfels, sh, view, splats, boxes, bars, surfel_bars, sh_bar, R_bar, p_bar, parts, first, last):
    """Pull the gradients of surfels in all views back, for parts first..last-1 of them.

    Args:
        surfels, sh, view, splats, boxes, bars, surfel_bars, sh_bar, R_bar, p_bar: as in
            `project_adjoint.pull_surfel`.
        parts: (parts + 1,), the first surfel of each part.
        first, last: range of parts.
    """
    basis, shares = np.empty(16, np.float32), np.empty(16, np.float32)
    for part in range(first, last):
        for v in range(boxes.shape[0]):
            for s in range(parts[part], parts[part + 1]):
                pull_surfel(
                    s, v, part, surfels, sh, view, splats, boxes, bars, surfel_bars, sh_bar, R_bar, p_bar, basis, shares
                )


@entry_point
def pull_rotations(q, R_bar, q_bar):
    """Gradient q_bar (V, 4) with respect to quaternions q (V, 4), wxyz, from that with respect to their rotations."""
    for v in range(q.shape[0]):
        first = (R_bar[v, 0, 0], R_bar[v, 1, 0], R_bar[v, 2, 0])
        second = (R_bar[v, 0, 1], R_bar[v, 1, 1], R_bar[v, 2, 1])
        third = (R_bar[v, 0, 2], R_bar[v, 1, 2], R_bar[v, 2, 2])
        q_bar[v] = quaternion_gradient(q[v, 0], q[v, 1], q[v, 2], q[v, 3], first, second, third)
