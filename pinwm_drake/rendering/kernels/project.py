# SPDX-License-Identifier: MIT
"""Surfels to the image plane (numba): plane, colour, opacity and the box of pixels that each can reach.

Surfels are worked on in blocks, whose numbers lie in small flat arrays, a channel after the other, so that the loop
over a block becomes vector instructions. What is the same in all views, such as a surfel's axes, is found once.
"""

import math

import numpy as np

from pinwm_drake.geometry.vectors import rotate_back
from pinwm_drake.jit import kernel
from pinwm_drake.rendering import reference
from pinwm_drake.rendering.kernels import columns as col
from pinwm_drake.rendering.kernels.columns import FOUR, HALF, LEAST_ALPHA, NEAR, ONE, TILE, TWO, ZERO
from pinwm_drake.rendering.kernels.harmonics import MOST_BASIS, Y0, fill_basis

# From the borders of a box to the centres of the pixels inside, px; a little wider, for rounding.
INSET, OUTSET = np.float32(0.5 + 1e-3), np.float32(0.5 - 1e-3)
# A plane whose image has less area than this part of its squared size is seen edge-on: only its disc counts.
EDGE_ON = np.float32(1e-6)
_STEEP = np.float32(1e12)

# Taylor's coefficients of exp(x / 64).
_E1, _E2, _E3, _E4, _E5, _E6 = (np.float32(1.0 / (math.factorial(n) * 64.0**n)) for n in range(1, 7))
_MOST_EXPONENT = np.float32(16.0)
_SLOPE_2, _SLOPE_3 = np.float32(1.0 / 0.3), np.float32(1.0 / 0.1)
_BASE_2, _BASE_3 = np.float32(math.log(0.3) - 1.0), np.float32(math.log(0.1) - 1.0)
_MOST_REACH = np.float32(-math.log(reference.LEAST_ALPHA))

# A smallest squared stretch, by the disc's, above which the disc hides the plane; a little more, for rounding.
_PLANE_HIDDEN = np.float32(1.001)

# A block of surfels; the channels of what is the same in all views; and of the work array, of what is found in one.
BLOCK = 64
_PX, _PY, _PZ, _AX, _AY, _AZ, _BX, _BY, _BZ, _UX, _UY, _UZ, _ALPHA, _REACH = range(14)
SAME = 14
_XC, _YC, _J00, _J01, _J10, _J11, _P0, _P1, _Z, _NX, _NY, _NZ = range(12)
_LEFT, _RIGHT, _TOP, _BOTTOM, _DX, _DY, _DZ, _SMALL = range(12, 20)
CHANNELS = 20


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
def exponential(x):
    """Exponential of x for |x| <= 16, to 4e-6 of it; the value at the limit beyond. It compiles to vector code."""
    r = min(max(x, -_MOST_EXPONENT), _MOST_EXPONENT)
    e = (((((_E6 * r + _E5) * r + _E4) * r + _E3) * r + _E2) * r + _E1) * r + ONE
    e = e * e
    e = e * e
    e = e * e
    e = e * e
    e = e * e
    return e * e


@kernel
def prepare_surfels(surfels, same):
    """Find what is the same in all views of surfels: centres, axes in their lengths, normals, opacities, reaches.

    Args:
        surfels: p_OS (N, 3), q_OS (N, 4), log_scale (N, 2), logit_opacity (N,).
        same: (blocks, 14, 64), receives it; beyond the last surfel that is repeated.
    """
    p, q, log_scale, logit = surfels
    for block in range(same.shape[0]):
        to = same[block]
        for i in range(BLOCK):
            s = np.uint64(min(block * BLOCK + i, p.shape[0] - 1))
            to[_PX, i], to[_PY, i], to[_PZ, i] = p[s, 0], p[s, 1], p[s, 2]
            to[_AX, i], to[_AY, i], to[_AZ, i], to[_BX, i] = q[s, 0], q[s, 1], q[s, 2], q[s, 3]
            to[_UX, i], to[_UY, i], to[_ALPHA, i] = log_scale[s, 0], log_scale[s, 1], logit[s]
        for i in range(BLOCK):
            ax, ay, az, bx, by, bz, ux, uy, uz = rotation_columns(to[_AX, i], to[_AY, i], to[_AZ, i], to[_BX, i])
            scale_a, scale_b = exponential(to[_UX, i]), exponential(to[_UY, i])
            opacity = ONE / (ONE + exponential(-to[_ALPHA, i]))
            # At least the logarithm, by its tangents at 1, 0.3 and 0.1: the box may be too large, never too small.
            logarithm = min(opacity - ONE, min(opacity * _SLOPE_2 + _BASE_2, opacity * _SLOPE_3 + _BASE_3))
            to[_AX, i], to[_AY, i], to[_AZ, i] = scale_a * ax, scale_a * ay, scale_a * az
            to[_BX, i], to[_BY, i], to[_BZ, i] = scale_b * bx, scale_b * by, scale_b * bz
            to[_UX, i], to[_UY, i], to[_UZ, i] = ux, uy, uz
            to[_ALPHA, i], to[_REACH, i] = opacity, TWO * (logarithm + _MOST_REACH)


@kernel
def _project_block(v, view, size, same, work):
    """Projects a block into view v; a surfel that is not seen gets an empty box, from 1 to 0."""
    R, t, intrinsics, steepness = view
    height, width = np.float32(size[0]), np.float32(size[1])
    fx, fy, cx, cy = intrinsics[v, 0], intrinsics[v, 1], intrinsics[v, 2], intrinsics[v, 3]
    r00, r01, r02 = R[v, 0, 0], R[v, 0, 1], R[v, 0, 2]
    r10, r11, r12 = R[v, 1, 0], R[v, 1, 1], R[v, 1, 2]
    r20, r21, r22 = R[v, 2, 0], R[v, 2, 1], R[v, 2, 2]
    tx, ty, tz = t[v, 0], t[v, 1], t[v, 2]
    ox, oy, oz = rotate_back(R[v], tx, ty, tz)
    for i in range(BLOCK):
        px, py, pz = same[_PX, i], same[_PY, i], same[_PZ, i]
        x, y = r00 * px + r01 * py + r02 * pz + tx, r10 * px + r11 * py + r12 * pz + ty
        z = r20 * px + r21 * py + r22 * pz + tz
        ux, uy, uz, vx, vy, vz = same[_AX, i], same[_AY, i], same[_AZ, i], same[_BX, i], same[_BY, i], same[_BZ, i]
        opacity, reach = same[_ALPHA, i], same[_REACH, i]
        ax, bx = r00 * ux + r01 * uy + r02 * uz, r00 * vx + r01 * vy + r02 * vz
        ay, by = r10 * ux + r11 * uy + r12 * uz, r10 * vx + r11 * vy + r12 * vz
        az, bz = r20 * ux + r21 * uy + r22 * uz, r20 * vx + r21 * vy + r22 * vz
        inverse = ONE / z
        # The image of the plane's u and v at the centre, px, and how z grows along them, relative to z.
        w0, w1, x_z, y_z = az * inverse, bz * inverse, x * inverse, y * inverse
        b00, b01 = fx * inverse * (ax - x_z * az), fx * inverse * (bx - x_z * bz)
        b10, b11 = fy * inverse * (ay - y_z * az), fy * inverse * (by - y_z * bz)
        xc, yc = fx * x_z + cx, fy * y_z + cy
        # Where opacity exp(-rho / 2) reaches the least that counts; the disc's radius there.
        radius = math.sqrt(max(reach / steepness[v], ZERO))
        bend = reach * (w0 * w0 + w1 * w1) - ONE
        k = reach / bend
        mx, my = k * (b00 * w0 + b01 * w1), k * (b10 * w0 + b11 * w1)
        ex = math.sqrt(max(mx * mx - k * (b00 * b00 + b01 * b01), ZERO))
        ey = math.sqrt(max(my * my - k * (b10 * b10 + b11 * b11), ZERO))
        left, right = min(xc - radius, xc + mx - ex), max(xc + radius, xc + mx + ex)
        top, bottom = min(yc - radius, yc + my - ey), max(yc + radius, yc + my + ey)
        # A surfel that reaches behind the camera may be anywhere.
        ahead = bend < ZERO
        left, right = left if ahead else ZERO, right if ahead else width
        top, bottom = top if ahead else ZERO, bottom if ahead else height
        # Comparisons that also fail for what is no number.
        seen = (opacity >= LEAST_ALPHA) & (z > NEAR) & (left <= right) & (top <= bottom)
        # First and last pixel whose centres may be inside.
        left, right = np.ceil(max(left - INSET, ZERO)), np.floor(min(right - OUTSET, width - ONE))
        top, bottom = np.ceil(max(top - INSET, ZERO)), np.floor(min(bottom - OUTSET, height - ONE))
        seen &= (left <= right) & (top <= bottom)
        work[_LEFT, i], work[_RIGHT, i] = left if seen else ONE, right if seen else ZERO
        work[_TOP, i], work[_BOTTOM, i] = top if seen else ONE, bottom if seen else ZERO
        work[_XC, i], work[_YC, i], work[_Z, i] = xc, yc, z
        det = b00 * b11 - b01 * b10
        facing = abs(det) > EDGE_ON * (b00 * b00 + b01 * b01 + b10 * b10 + b11 * b11)
        flat = ONE / det
        j00, j01 = b11 * flat if facing else _STEEP, -b01 * flat if facing else ZERO
        j10, j11 = -b10 * flat if facing else ZERO, b00 * flat if facing else _STEEP
        work[_J00, i], work[_J01, i], work[_J10, i], work[_J11, i] = j00, j01, j10, j11
        work[_P0, i] = -(w0 * j00 + w1 * j10) if facing else ZERO
        work[_P1, i] = -(w0 * j01 + w1 * j11) if facing else ZERO
        # rho >= |d|^2 s^2 / q_2^2, s being the smallest stretch of J: where that is more than the disc's rho everywhere
        # in its reach, the plane is not seen.
        bend = ONE + radius * (abs(work[_P0, i]) + abs(work[_P1, i]))
        squares, det = j00 * j00 + j01 * j01 + j10 * j10 + j11 * j11, j00 * j11 - j01 * j10
        stretch = HALF * (squares - math.sqrt(max(squares * squares - FOUR * det * det, ZERO)))
        work[_SMALL, i] = ONE if stretch > _PLANE_HIDDEN * steepness[v] * bend * bend else ZERO
        ux, uy, uz = same[_UX, i], same[_UY, i], same[_UZ, i]
        nx, ny = r00 * ux + r01 * uy + r02 * uz, r10 * ux + r11 * uy + r12 * uz
        nz = r20 * ux + r21 * uy + r22 * uz
        side = -ONE if nx * x + ny * y + nz * z > ZERO else ONE
        work[_NX, i], work[_NY, i], work[_NZ, i] = side * nx, side * ny, side * nz
        dx, dy, dz = px + ox, py + oy, pz + oz
        inverse = ONE / math.sqrt(dx * dx + dy * dy + dz * dz)
        work[_DX, i], work[_DY, i], work[_DZ, i] = dx * inverse, dy * inverse, dz * inverse


@kernel
def project_surfels(v, slot, same, sh, view, size, whole, splats, depths, boxes, basis, work):
    """Projects all surfels into view v.

    Args:
        v: the view.
        slot: index in `splats`, `depths` and `boxes` that receives the view.
        same: (blocks, 14, 64), of `prepare_surfels`.
        sh: (1 or V, N, K, 3).
        view: R_CO (V, 3, 3), p_CO (V, 3), intrinsics (V, 4), and rho (V,) of the discs one pixel from their centres.
        size: height and width, px.
        whole: whether all columns of `splats` are wanted; else only those that `blend_tile` reads without `full`.
        splats: (slots, N, 16), receives the columns of `columns.py`.
        depths: (slots, N), receives the centres' z, m.
        boxes: (slots, N, 5) int32, receives first and last-plus-one pixel row, and tile column, empty if
            not to be seen; and whether only its disc is.
        basis: (16,); work: (20, 64).

    Returns:
        How many tiles the boxes have in all.
    """
    own, slot = np.uint64(v if sh.shape[0] > 1 else 0), np.uint64(slot)
    number = sh.shape[2]
    basis[0] = Y0
    total = np.int64(0)
    for block in range(same.shape[0]):
        first = block * BLOCK
        _project_block(v, view, size, same[block], work)
        for i in range(min(BLOCK, boxes.shape[1] - first)):
            s = np.uint64(first + i)
            if work[_LEFT, i] > work[_RIGHT, i]:
                boxes[slot, s, 0], boxes[slot, s, 1] = 0, 0
                continue
            top, bottom = np.int32(work[_TOP, i]), np.int32(work[_BOTTOM, i])
            left, right = np.int32(work[_LEFT, i]) // TILE, np.int32(work[_RIGHT, i]) // TILE
            total += (bottom // TILE - top // TILE + 1) * (right - left + 1)
            boxes[slot, s, 0], boxes[slot, s, 1] = top, bottom + 1
            boxes[slot, s, 2], boxes[slot, s, 3] = left, right + 1
            boxes[slot, s, 4] = 1 if work[_SMALL, i] > ZERO else 0
            depths[slot, s] = work[_Z, i]
            splats[slot, s, col.XC], splats[slot, s, col.YC] = work[_XC, i], work[_YC, i]
            splats[slot, s, col.OPACITY] = same[block, _ALPHA, i]
            if whole or work[_SMALL, i] <= ZERO:
                splats[slot, s, col.Z] = work[_Z, i]
                splats[slot, s, col.J00], splats[slot, s, col.J01] = work[_J00, i], work[_J01, i]
                splats[slot, s, col.J10], splats[slot, s, col.J11] = work[_J10, i], work[_J11, i]
                splats[slot, s, col.P0], splats[slot, s, col.P1] = work[_P0, i], work[_P1, i]
            if whole:
                splats[slot, s, col.NX], splats[slot, s, col.NY] = work[_NX, i], work[_NY, i]
                splats[slot, s, col.NZ] = work[_NZ, i]
            if number > 1:
                fill_basis(work[_DX, i], work[_DY, i], work[_DZ, i], number, basis)
            red, green, blue = HALF, HALF, HALF
            if number == MOST_BASIS:
                # The same as below, but of a length that the compiler knows.
                for k in range(MOST_BASIS):
                    red += basis[k] * sh[own, s, k, 0]
                    green += basis[k] * sh[own, s, k, 1]
                    blue += basis[k] * sh[own, s, k, 2]
            else:
                for k in range(number):
                    red += basis[k] * sh[own, s, k, 0]
                    green += basis[k] * sh[own, s, k, 1]
                    blue += basis[k] * sh[own, s, k, 2]
            splats[slot, s, col.RED], splats[slot, s, col.GREEN] = max(red, ZERO), max(green, ZERO)
            splats[slot, s, col.BLUE] = max(blue, ZERO)
    return total
