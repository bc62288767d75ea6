# SPDX-License-Identifier: MIT
"""Adjoint of `blend.py` (numba): from gradients of pixels to gradients of projected surfels.

It goes front to back once more. With w_i = T_i alpha_i the weights, f_i a surfel's features on a pixel and g the
pixel's gradient, G_i = g . f_i, and sum_i w_i G_i = g . (the blended pixel) is known from the forward pass; so

    dL/dalpha_i = T_i G_i - (sum_{j>i} w_j G_j) / (1 - alpha_i)

needs only the rest of that sum, and no pass from back to front.
"""

import numpy as np

from pinwm_drake.jit import kernel
from pinwm_drake.rendering.kernels import columns as col
from pinwm_drake.rendering.kernels.blend import (
    LEAST_TRANSMITTANCE,
    MOST_ALPHA,
    PATIENCE,
    falloff,
    opaque,
    pairs_of_rows,
    reach,
)
from pinwm_drake.rendering.kernels.columns import HALF, LEAST_ALPHA, NEAR, ONE, PIXELS, TILE, TWO, ZERO

# Channels of a tile's work array: what is left of transmittance and of g . pixel, g, and where
# the pixel's centre is.
_T, _REST, _GR, _GG, _GB, _GA, _GM1, _GM2, _GNX, _GNY, _GNZ, X, Y = (PIXELS * channel for channel in range(13))
CHANNELS = 13


def _pulling(full):
    """Kernel that pulls the gradients of a tile back to one surfel, those of depth and normal too (`full`)."""

    @kernel
    def pull(work, bars, part, splats, v, s, x_center, y_center, first, last, steepness, origin):
        opacity, z_center = splats[v, s, col.OPACITY], splats[v, s, col.Z]
        j00, j01 = splats[v, s, col.J00], splats[v, s, col.J01]
        j10, j11 = splats[v, s, col.J10], splats[v, s, col.J11]
        p0, p1 = splats[v, s, col.P0], splats[v, s, col.P1]
        most_q2 = z_center / NEAR
        red, green, blue = splats[v, s, col.RED], splats[v, s, col.GREEN], splats[v, s, col.BLUE]
        nx, ny, nz = splats[v, s, col.NX], splats[v, s, col.NY], splats[v, s, col.NZ]
        sum_r = sum_g = sum_b = sum_o = sum_z = ZERO
        sum_nx = sum_ny = sum_nz = ZERO
        sum_s0 = sum_s1 = sum_s2 = sum_dx = sum_dy = ZERO
        sum_x0 = sum_x1 = sum_x2 = sum_y0 = sum_y1 = sum_y2 = ZERO
        start, number = pairs_of_rows(first, last)
        for i in range(number):
            k = start + i
            dx, dy = work[X + k] - x_center, work[Y + k] - y_center
            q0, q1, inverse, rho, on_plane = reach(dx, dy, j00, j01, j10, j11, p0, p1, most_q2, steepness)
            e = falloff(rho)
            alpha = min(opacity * e, MOST_ALPHA)
            left = work[_T + k]
            counts = (alpha >= LEAST_ALPHA) & (left > LEAST_TRANSMITTANCE)
            weight = left * alpha if counts else ZERO
            gr, gg, gb = work[_GR + k], work[_GG + k], work[_GB + k]
            g = gr * red + gg * green + gb * blue + work[_GA + k]
            if full:
                stretch = inverse if on_plane else ONE
                z = z_center * stretch - origin
                gnx, gny, gnz = work[_GNX + k], work[_GNY + k], work[_GNZ + k]
                gm1, gm2 = work[_GM1 + k], work[_GM2 + k]
                g += gnx * nx + gny * ny + gnz * nz + (gm1 + gm2 * z) * z
                sum_nx += weight * gnx
                sum_ny += weight * gny
                sum_nz += weight * gnz
                d_z = weight * (gm1 + TWO * gm2 * z) * stretch
                sum_z += d_z
            rest = work[_REST + k] - weight * g
            work[_REST + k] = rest
            work[_T + k] = left - weight
            sum_r += weight * gr
            sum_g += weight * gg
            sum_b += weight * gb
            free = counts & (alpha < MOST_ALPHA)
            slope = left * g - rest / (ONE - alpha)
            d = slope if free else ZERO
            sum_o += d * e
            d_rho = -HALF * alpha * d
            d_disc = ZERO if on_plane else d_rho
            sum_dx += d_disc * dx
            sum_dy += d_disc * dy
            inverse = inverse if on_plane else ZERO
            h = TWO * d_rho * inverse * inverse
            fall = h * (q0 * q0 + q1 * q1)
            if full:
                fall += d_z * z_center
            d0, d1, d2 = h * q0, h * q1, -fall * inverse
            sum_s0 += d0
            sum_s1 += d1
            sum_s2 += d2
            sum_x0 += d0 * dx
            sum_x1 += d1 * dx
            sum_x2 += d2 * dx
            sum_y0 += d0 * dy
            sum_y1 += d1 * dy
            sum_y2 += d2 * dy
        bars[part, v, s, col.XC] -= sum_s0 * j00 + sum_s1 * j10 + sum_s2 * p0 + TWO * steepness * sum_dx
        bars[part, v, s, col.YC] -= sum_s0 * j01 + sum_s1 * j11 + sum_s2 * p1 + TWO * steepness * sum_dy
        bars[part, v, s, col.J00] += sum_x0
        bars[part, v, s, col.J01] += sum_y0
        bars[part, v, s, col.J10] += sum_x1
        bars[part, v, s, col.J11] += sum_y1
        bars[part, v, s, col.P0] += sum_x2
        bars[part, v, s, col.P1] += sum_y2
        bars[part, v, s, col.OPACITY] += sum_o
        bars[part, v, s, col.RED] += sum_r
        bars[part, v, s, col.GREEN] += sum_g
        bars[part, v, s, col.BLUE] += sum_b
        if full:
            bars[part, v, s, col.Z] += sum_z
            bars[part, v, s, col.NX] += sum_nx
            bars[part, v, s, col.NY] += sum_ny
            bars[part, v, s, col.NZ] += sum_nz

    return pull


_pull_color, _pull_full = _pulling(False), _pulling(True)


@kernel
def pull_tile(v, row, column, scene, steepness, origin, images, image_bars, bars, part, work):
    """Pull the gradients of one tile's pixels back to the surfels in it.

    Args:
        v, row, column, scene, steepness, origin, images: as in `blend.blend_tile`.
        image_bars: gradients with respect to `images`.
        bars: (parts, V, N, 16), the gradients with respect to `splats` are added to its part.
        part: index of the part of `bars` that gains the gradients.
        work: (13 * 64,), with its places filled in.
    """
    splats, boxes, starts, entries, background, full = scene
    color, alpha, m1, m2, normal = images
    color_bar, alpha_bar, m1_bar, m2_bar, normal_bar = image_bars
    height, width = alpha.shape[1], alpha.shape[2]
    columns = (width + TILE - 1) // TILE
    tile = row * columns + column
    if starts[v, tile] == starts[v, tile + 1]:
        return
    for i in range(X):
        work[i] = ZERO
    some = False
    for i in range(min(TILE, height - row * TILE)):
        y = row * TILE + i
        for j in range(min(TILE, width - column * TILE)):
            x, k = column * TILE + j, i * TILE + j
            left = ONE - alpha[v, y, x]
            g_alpha, rest = alpha_bar[v, y, x], ZERO
            for c in range(3):
                g = color_bar[v, y, x, c]
                work[_GR + c * PIXELS + k] = g
                rest += g * (color[v, y, x, c] - left * background[c])
                g_alpha -= g * background[c]
            work[_GA + k] = g_alpha
            rest += g_alpha * alpha[v, y, x]
            if full:
                for c in range(3):
                    g = normal_bar[v, y, x, c]
                    work[_GNX + c * PIXELS + k] = g
                    rest += g * normal[v, y, x, c]
                work[_GM1 + k], work[_GM2 + k] = m1_bar[v, y, x], m2_bar[v, y, x]
                rest += m1_bar[v, y, x] * m1[v, y, x] + m2_bar[v, y, x] * m2[v, y, x]
            work[_REST + k] = rest
            # Pixels beyond the image's edge stay opaque.
            work[_T + k] = ONE
    for i in range(_GR, X):
        some |= work[i] != ZERO
    if not some:
        return
    x_tile, y_tile = np.float32(column * TILE) + HALF, np.float32(row * TILE) + HALF
    for e in range(starts[v, tile], starts[v, tile + 1]):
        s = entries[e]
        top, bottom = max(boxes[v, s, 0] - row * TILE, 0), min(boxes[v, s, 1] - row * TILE, TILE)
        x_center, y_center = splats[v, s, col.XC] - x_tile, splats[v, s, col.YC] - y_tile
        if full:
            _pull_full(work, bars, part, splats, v, s, x_center, y_center, top, bottom, steepness, origin)
        else:
            _pull_color(work, bars, part, splats, v, s, x_center, y_center, top, bottom, steepness, origin)
        if (e - starts[v, tile]) % PATIENCE == PATIENCE - 1 and opaque(work):
            break
