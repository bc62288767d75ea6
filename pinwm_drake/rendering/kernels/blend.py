# SPDX-License-Identifier: MIT
"""Blends the surfels of each tile front to back (numba).

A tile's 8 x 8 pixels live in one small flat array, a channel after the other, so that the loop over the
pixels becomes a few vector instructions. There are no branches in it: what does not count has opacity 0. It runs over
whole pairs of rows.
"""

import numpy as np

from pinwm_drake.jit import kernel
from pinwm_drake.rendering import reference
from pinwm_drake.rendering.kernels import columns as col
from pinwm_drake.rendering.kernels.columns import HALF, LEAST_ALPHA, NEAR, ONE, PIXELS, TILE, ZERO

MOST_ALPHA, LEAST_TRANSMITTANCE = np.float32(reference.MOST_ALPHA), np.float32(reference.LEAST_TRANSMITTANCE)

# exp(-rho / 2) = p(rho)^16 with p(rho) = exp(-rho / 32), a polynomial on [0, 12], where rho stays when it counts.
# Its relative error is 2e-7 there, p's being a least-squares fit of degree 5.
_FIT = np.polynomial.chebyshev.Chebyshev.interpolate(lambda rho: np.exp(-rho / 32.0), 5, [0.0, 12.0])
E0, E1, E2, E3, E4, E5 = (np.float32(c) for c in _FIT.convert(kind=np.polynomial.Polynomial).coef)
MOST_RHO = np.float32(12.0)

# Channels of a tile's work array.
_T, _R, _G, _B, _M1, _M2, _NX, _NY, _NZ, X, Y = (PIXELS * channel for channel in range(11))
CHANNELS = 11

# After how many surfels a tile is tried for being opaque.
PATIENCE = 8


@kernel
def falloff(rho):
    """Falloff exp(-rho / 2) for 0 <= rho <= 12; 0.0025 beyond."""
    r = min(rho, MOST_RHO)
    e = ((((E5 * r + E4) * r + E3) * r + E2) * r + E1) * r + E0
    e = e * e
    e = e * e
    e = e * e
    return e * e


@kernel
def reach(dx, dy, j00, j01, j10, j11, p0, p1, most_q2, steepness):
    """Return a surfel seen from (dx, dy) px beside its centre: q_0, q_1, 1 / q_2, rho, and whether rho is its plane's.

    The plane counts where it is ahead of the near plane, 0 < q_2 < most_q2, and opaquer than the disc, whose rho is
    `steepness` one pixel from the centre.
    """
    q0, q1, q2 = j00 * dx + j01 * dy, j10 * dx + j11 * dy, p0 * dx + p1 * dy + ONE
    inverse = ONE / q2
    rho = (q0 * q0 + q1 * q1) * (inverse * inverse)
    disc = steepness * (dx * dx + dy * dy)
    on_plane = (rho <= disc) & (q2 > ZERO) & (q2 < most_q2)
    return q0, q1, inverse, rho if on_plane else disc, on_plane


@kernel
def pairs_of_rows(first, last):
    """First entry in a channel of the pairs of rows that hold rows first..last-1 of a tile, and number of their pixels.

    The masks tell the compiler that no index is negative, and that nothing is left over beside vectors of 16.
    """
    first &= TILE - 2
    return first * TILE, (((last - first + 1) >> 1) & (TILE - 1)) * (2 * TILE)


@kernel
def opaque(work):
    """Flag: no pixel of the tile takes more."""
    open_pixels = 0
    for i in range(PIXELS):
        open_pixels += 1 if work[_T + i] > LEAST_TRANSMITTANCE else 0
    return open_pixels == 0


@kernel
def fill_places(work, x, y):
    """Write the places of a tile's pixels, counted from its first one: columns into work[x:], rows into work[y:]."""
    for i in range(PIXELS):
        work[x + i], work[y + i] = np.float32(i % TILE), np.float32(i // TILE)


def _blending(full, disc):
    """Kernel that blends one surfel into a tile: its disc alone (`disc`), and depth and normal too (`full`)."""

    @kernel
    def blend(work, splats, v, s, x_center, y_center, first, last, steepness, origin):
        opacity, z_center = splats[v, s, col.OPACITY], splats[v, s, col.Z]
        j00, j01 = splats[v, s, col.J00], splats[v, s, col.J01]
        j10, j11 = splats[v, s, col.J10], splats[v, s, col.J11]
        p0, p1 = splats[v, s, col.P0], splats[v, s, col.P1]
        most_q2 = z_center / NEAR
        red, green, blue = splats[v, s, col.RED], splats[v, s, col.GREEN], splats[v, s, col.BLUE]
        nx, ny, nz = splats[v, s, col.NX], splats[v, s, col.NY], splats[v, s, col.NZ]
        start, number = pairs_of_rows(first, last)
        for i in range(number):
            k = start + i
            dx, dy = work[X + k] - x_center, work[Y + k] - y_center
            _, _, inverse, rho, on_plane = reach(dx, dy, j00, j01, j10, j11, p0, p1, most_q2, steepness)
            if disc:
                rho = steepness * (dx * dx + dy * dy)
            alpha = min(opacity * falloff(rho), MOST_ALPHA)
            left = work[_T + k]
            counts = (alpha >= LEAST_ALPHA) & (left > LEAST_TRANSMITTANCE)
            weight = left * alpha if counts else ZERO
            work[_T + k] = left - weight
            work[_R + k] += weight * red
            work[_G + k] += weight * green
            work[_B + k] += weight * blue
            if full:
                z = (z_center * inverse if on_plane else z_center) - origin
                work[_M1 + k] += weight * z
                work[_M2 + k] += weight * z * z
                work[_NX + k] += weight * nx
                work[_NY + k] += weight * ny
                work[_NZ + k] += weight * nz

    return blend


_blend_color, _blend_disc, _blend_full = _blending(False, False), _blending(False, True), _blending(True, False)


@kernel
def blend_tile(v, slot, row, column, scene, steepness, origin, images, work):
    """Blends one tile of view v and writes its pixels.

    Args:
        v: the view.
        slot: index of the view in the arrays of `scene`.
        row, column: the tile.
        scene: splats (slots, N, 16), projected surfels; boxes (slots, N, 5), rows of pixels and columns of tiles that
            a surfel may reach, and whether only its disc is seen; starts and entries, the tiles' lists from `bins.py`;
            background (3,); and full, whether to write more than color and alpha.
        steepness: rho of the discs one pixel from their centres.
        origin: depth from which depths are counted, m, so that their squares keep their digits.
        images: color (V, H, W, 3), alpha (V, H, W), first and second moment of depth (V, H, W), normal (V, H, W, 3).
        work: (11 * 64,), with its places filled in.
    """
    splats, boxes, starts, entries, background, full = scene
    color, alpha, m1, m2, normal = images
    height, width = alpha.shape[1], alpha.shape[2]
    columns = (width + TILE - 1) // TILE
    tile, slot = row * columns + column, np.uint64(slot)
    if starts[slot, tile] == starts[slot, tile + 1] and not full:
        for y in range(row * TILE, min(row * TILE + TILE, height)):
            for x in range(column * TILE, min(column * TILE + TILE, width)):
                alpha[v, y, x] = ZERO
                for c in range(3):
                    color[v, y, x, c] = background[c]
        return
    for i in range(PIXELS):
        work[_T + i] = ONE
    for i in range(_R, X if full else _M1):
        work[i] = ZERO
    x_tile, y_tile = np.float32(column * TILE) + HALF, np.float32(row * TILE) + HALF
    for e in range(starts[slot, tile], starts[slot, tile + 1]):
        s = np.uint64(entries[np.uint64(e)])
        top, bottom = max(boxes[slot, s, 0] - row * TILE, 0), min(boxes[slot, s, 1] - row * TILE, TILE)
        x_center, y_center = splats[slot, s, col.XC] - x_tile, splats[slot, s, col.YC] - y_tile
        if full:
            _blend_full(work, splats, slot, s, x_center, y_center, top, bottom, steepness, origin)
        elif boxes[slot, s, 4] != 0:
            _blend_disc(work, splats, slot, s, x_center, y_center, top, bottom, steepness, origin)
        else:
            _blend_color(work, splats, slot, s, x_center, y_center, top, bottom, steepness, origin)
        if (e - starts[slot, tile]) % PATIENCE == PATIENCE - 1 and opaque(work):
            break
    for i in range(min(TILE, height - row * TILE)):
        y = row * TILE + i
        for j in range(min(TILE, width - column * TILE)):
            x, k = column * TILE + j, i * TILE + j
            left = work[_T + k]
            alpha[v, y, x] = ONE - left
            color[v, y, x, 0] = work[_R + k] + left * background[0]
            color[v, y, x, 1] = work[_G + k] + left * background[1]
            color[v, y, x, 2] = work[_B + k] + left * background[2]
            if full:
                m1[v, y, x] = work[_M1 + k]
                m2[v, y, x] = work[_M2 + k]
                normal[v, y, x, 0] = work[_NX + k]
                normal[v, y, x, 1] = work[_NY + k]
                normal[v, y, x, 2] = work[_NZ + k]
