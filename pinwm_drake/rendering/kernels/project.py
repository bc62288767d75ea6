"""Surfels to the image plane (numba): plane, colour, opacity and the box of pixels that each can reach."""

import math

import numpy as np

from pinwm_drake.jit import kernel
from pinwm_drake.rendering import reference
from pinwm_drake.rendering.kernels.columns import (
    BLUE,
    GREEN,
    J00,
    J01,
    J10,
    J11,
    NX,
    NY,
    NZ,
    OPACITY,
    P0,
    P1,
    RED,
    TILE,
    XC,
    YC,
    Z,
)
from pinwm_drake.rendering.kernels.harmonics import fill_basis

ZERO, HALF, ONE, TWO = np.float32(0.0), np.float32(0.5), np.float32(1.0), np.float32(2.0)
NEAR = np.float32(reference.NEAR)
LEAST_ALPHA = np.float32(reference.LEAST_ALPHA)
# The box is widened by this, px, for rounding.
_SLACK = np.float32(1e-3)
# A plane whose image has less area than this part of its squared size is seen edge-on: only its disc counts.
EDGE_ON = np.float32(1e-6)
_STEEP = np.float32(1e12)


@kernel
def rotation_columns(w, x, y, z):
    """First and second column, and third, of the rotation of a quaternion of any length."""
    s = TWO / (w * w + x * x + y * y + z * z)
    return (
        ONE - s * (y * y + z * z),
        s * (x * y + w * z),
        s * (x * z - w * y),
        s * (x * y - w * z),
        ONE - s * (x * x + z * z),
        s * (y * z + w * x),
        s * (x * z + w * y),
        s * (y * z - w * x),
        ONE - s * (x * x + y * y),
    )


@kernel
def turn(R, v, x, y, z):
    """R[v] (x, y, z)."""
    return (
        R[v, 0, 0] * x + R[v, 0, 1] * y + R[v, 0, 2] * z,
        R[v, 1, 0] * x + R[v, 1, 1] * y + R[v, 1, 2] * z,
        R[v, 2, 0] * x + R[v, 2, 1] * y + R[v, 2, 2] * z,
    )


@kernel
def turn_back(R, v, x, y, z):
    """R[v]' (x, y, z)."""
    return (
        R[v, 0, 0] * x + R[v, 1, 0] * y + R[v, 2, 0] * z,
        R[v, 0, 1] * x + R[v, 1, 1] * y + R[v, 2, 1] * z,
        R[v, 0, 2] * x + R[v, 1, 2] * y + R[v, 2, 2] * z,
    )


@kernel
def _pixels(low, high, number):
    """First and last-plus-one of `number` pixels whose centres may lie in [low, high]."""
    first = math.ceil(max(low - HALF - _SLACK, ZERO))
    last = math.floor(min(high - HALF + _SLACK, np.float32(number - 1)))
    if last < first:
        return 0, 0
    return int(first), int(last) + 1


@kernel
def project_surfels(v, surfels, sh, view, size, splats, depths, boxes, basis):
    """Projects all surfels into view v.

    Args:
        v: the view.
        surfels: p_OS (N, 3), q_OS (N, 4), log_scale (N, 2), logit_opacity (N,).
        sh: (1 or V, N, K, 3).
        view: R_CO (V, 3, 3), p_CO (V, 3), intrinsics (V, 4).
        size: height and width, px.
        splats: (V, N, 16), receives the columns of `columns.py`.
        depths: (V, N), receives the centres' z, m.
        boxes: (V, N, 4) int32, receives first and last-plus-one pixel row, and tile column; empty if not to be seen.
        basis: (16,), work.

    Returns:
        How many tiles the boxes have in all.
    """
    p, q, log_scale, logit = surfels
    R, t, intrinsics = view
    height, width = size
    fx, fy, cx, cy = intrinsics[v, 0], intrinsics[v, 1], intrinsics[v, 2], intrinsics[v, 3]
    ox, oy, oz = turn_back(R, v, t[v, 0], t[v, 1], t[v, 2])
    own = v if sh.shape[0] > 1 else 0
    number = sh.shape[2]
    total = 0
    for s in range(p.shape[0]):
        boxes[v, s, 0], boxes[v, s, 1], boxes[v, s, 2], boxes[v, s, 3] = 0, 0, 0, 0
        opacity = ONE / (ONE + math.exp(-logit[s]))
        if not opacity >= LEAST_ALPHA:
            continue
        px, py, pz = p[s, 0], p[s, 1], p[s, 2]
        x, y, z = turn(R, v, px, py, pz)
        x, y, z = x + t[v, 0], y + t[v, 1], z + t[v, 2]
        if not z > NEAR:
            continue
        ax, ay, az, bx, by, bz, nx, ny, nz = rotation_columns(q[s, 0], q[s, 1], q[s, 2], q[s, 3])
        scale_a, scale_b = math.exp(log_scale[s, 0]), math.exp(log_scale[s, 1])
        ax, ay, az = turn(R, v, scale_a * ax, scale_a * ay, scale_a * az)
        bx, by, bz = turn(R, v, scale_b * bx, scale_b * by, scale_b * bz)
        inverse = ONE / z
        # The image of the plane's u and v at the centre, px, and how z grows along them, relative to z.
        w0, w1 = az * inverse, bz * inverse
        x_z, y_z = x * inverse, y * inverse
        b00, b01 = fx * inverse * (ax - x_z * az), fx * inverse * (bx - x_z * bz)
        b10, b11 = fy * inverse * (ay - y_z * az), fy * inverse * (by - y_z * bz)
        xc, yc = fx * x_z + cx, fy * y_z + cy
        # Where opacity exp(-rho / 2) reaches the least that counts; the disc's radius there.
        reach = TWO * math.log(opacity / LEAST_ALPHA)
        radius = math.sqrt(HALF * reach)
        left, right, top, bottom = xc - radius, xc + radius, yc - radius, yc + radius
        bend = reach * (w0 * w0 + w1 * w1) - ONE
        if bend < ZERO:
            mx, my = reach * (b00 * w0 + b01 * w1) / bend, reach * (b10 * w0 + b11 * w1) / bend
            ex = math.sqrt(max(mx * mx - reach * (b00 * b00 + b01 * b01) / bend, ZERO))
            ey = math.sqrt(max(my * my - reach * (b10 * b10 + b11 * b11) / bend, ZERO))
            left, right = min(left, xc + mx - ex), max(right, xc + mx + ex)
            top, bottom = min(top, yc + my - ey), max(bottom, yc + my + ey)
        else:
            # The surfel reaches behind the camera: it may be anywhere.
            left, right, top, bottom = ZERO, np.float32(width), ZERO, np.float32(height)
        # Sizes out of all range can end up as no number.
        if not (left <= right and top <= bottom):
            continue
        first_row, last_row = _pixels(top, bottom, height)
        first_column, last_column = _pixels(left, right, width)
        if last_row == 0 or last_column == 0:
            continue
        first_column, last_column = first_column // TILE, (last_column + TILE - 1) // TILE
        total += ((last_row + TILE - 1) // TILE - first_row // TILE) * (last_column - first_column)
        boxes[v, s, 0], boxes[v, s, 1] = first_row, last_row
        boxes[v, s, 2], boxes[v, s, 3] = first_column, last_column
        det = b00 * b11 - b01 * b10
        if abs(det) > EDGE_ON * (b00 * b00 + b01 * b01 + b10 * b10 + b11 * b11):
            j00, j01, j10, j11 = b11 / det, -b01 / det, -b10 / det, b00 / det
            splats[v, s, P0], splats[v, s, P1] = -(w0 * j00 + w1 * j10), -(w0 * j01 + w1 * j11)
        else:
            j00, j01, j10, j11 = _STEEP, ZERO, ZERO, _STEEP
            splats[v, s, P0], splats[v, s, P1] = ZERO, ZERO
        splats[v, s, XC], splats[v, s, YC] = xc, yc
        splats[v, s, J00], splats[v, s, J01], splats[v, s, J10], splats[v, s, J11] = j00, j01, j10, j11
        splats[v, s, Z] = z
        depths[v, s] = z
        splats[v, s, OPACITY] = opacity
        nx, ny, nz = turn(R, v, nx, ny, nz)
        if nx * x + ny * y + nz * z > ZERO:
            nx, ny, nz = -nx, -ny, -nz
        splats[v, s, NX], splats[v, s, NY], splats[v, s, NZ] = nx, ny, nz
        dx, dy, dz = px + ox, py + oy, pz + oz
        inverse = ONE / math.sqrt(dx * dx + dy * dy + dz * dz)
        fill_basis(dx * inverse, dy * inverse, dz * inverse, number, basis)
        red, green, blue = HALF, HALF, HALF
        for k in range(number):
            red += basis[k] * sh[own, s, k, 0]
            green += basis[k] * sh[own, s, k, 1]
            blue += basis[k] * sh[own, s, k, 2]
        splats[v, s, RED], splats[v, s, GREEN], splats[v, s, BLUE] = max(red, ZERO), max(green, ZERO), max(blue, ZERO)
    return total
