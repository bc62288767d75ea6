# SPDX-License-Identifier: MIT
"""Adjoint of `project.py` (numba): from gradients of projected surfels to surfels, harmonics and pose."""

import math

from pinwm_drake.geometry.vectors import rotate, rotate_back
from pinwm_drake.jit import kernel
from pinwm_drake.rendering.kernels import columns as col
from pinwm_drake.rendering.kernels.columns import ONE, TWO, ZERO
from pinwm_drake.rendering.kernels.harmonics import basis_gradient, fill_basis
from pinwm_drake.rendering.kernels.project import EDGE_ON, exponential, rotation_columns


@kernel
def _add_outer(R_bar, part, v, x, y, z, a, b, c):
    """Add an outer product: R_bar += (x, y, z) (a, b, c)'."""
    for i, row in enumerate((x, y, z)):
        R_bar[part, v, i, 0] += row * a
        R_bar[part, v, i, 1] += row * b
        R_bar[part, v, i, 2] += row * c


@kernel
def quaternion_gradient(w, x, y, z, ga, gb, gn):
    """Gradient with respect to a quaternion of any length from those of its rotation's three columns."""
    s = TWO / (w * w + x * x + y * y + z * z)
    a, b, n = rotation_columns(w, x, y, z)[:3], rotation_columns(w, x, y, z)[3:6], rotation_columns(w, x, y, z)[6:]
    # R = 1 + s K with K quadratic in the quaternion, so dR/ds = (R - 1) / s.
    along = (a[0] - ONE) * ga[0] + a[1] * ga[1] + a[2] * ga[2]
    along += b[0] * gb[0] + (b[1] - ONE) * gb[1] + b[2] * gb[2]
    along += n[0] * gn[0] + n[1] * gn[1] + (n[2] - ONE) * gn[2]
    # ds = -s^2 q . dq
    fall = -along * s
    gw = z * (ga[1] - gb[0]) + y * (gn[0] - ga[2]) + x * (gb[2] - gn[1])
    gx = y * (ga[1] + gb[0]) + z * (ga[2] + gn[0]) + w * (gb[2] - gn[1]) - TWO * x * (gb[1] + gn[2])
    gy = x * (ga[1] + gb[0]) + z * (gb[2] + gn[1]) + w * (gn[0] - ga[2]) - TWO * y * (ga[0] + gn[2])
    gz = x * (ga[2] + gn[0]) + y * (gb[2] + gn[1]) + w * (ga[1] - gb[0]) - TWO * z * (ga[0] + gb[1])
    return s * gw + fall * w, s * gx + fall * x, s * gy + fall * y, s * gz + fall * z


@kernel
def pull_surfel(s, v, part, surfels, sh, view, splats, boxes, bars, surfel_bars, sh_bar, R_bar, p_bar, basis, shares):
    """Pull the gradients of surfel s in view v back.

    Args:
        s, v: the surfel and the view.
        part: index of the part of `R_bar` and `p_bar` that gains the sums.
        surfels, sh, view, splats, boxes: as in `project.project_surfels`.
        bars: (parts, V, N, 16), gradients with respect to `splats`, summed over parts here.
        surfel_bars: as `surfels`, receive sums.
        sh_bar: (1 or V, N, K, 3), receives sums.
        R_bar, p_bar: (parts, V, 3, 3), (parts, V, 3) float64, receive sums.
        basis, shares: (16,), work.
    """
    p, q, log_scale, _ = surfels
    p_out, q_out, scale_out, opacity_out = surfel_bars
    R, t, intrinsics, _ = view
    if boxes[v, s, 0] >= boxes[v, s, 1]:
        return
    first = bars[0, v, s]
    for i in range(1, bars.shape[0]):
        for k in range(16):
            first[k] += bars[i, v, s, k]
    fx, fy = intrinsics[v, 0], intrinsics[v, 1]
    px, py, pz = p[s, 0], p[s, 1], p[s, 2]
    x, y, z = rotate(R[v], px, py, pz)
    x, y, z = x + t[v, 0], y + t[v, 1], z + t[v, 2]
    qw, qx, qy, qz = q[s, 0], q[s, 1], q[s, 2], q[s, 3]
    ux, uy, uz, vx, vy, vz, nx, ny, nz = rotation_columns(qw, qx, qy, qz)
    scale_a, scale_b = exponential(log_scale[s, 0]), exponential(log_scale[s, 1])
    ax, ay, az = rotate(R[v], scale_a * ux, scale_a * uy, scale_a * uz)
    bx, by, bz = rotate(R[v], scale_b * vx, scale_b * vy, scale_b * vz)
    inverse = ONE / z
    w0, w1, x_z, y_z = az * inverse, bz * inverse, x * inverse, y * inverse
    b00, b01 = fx * inverse * (ax - x_z * az), fx * inverse * (bx - x_z * bz)
    b10, b11 = fy * inverse * (ay - y_z * az), fy * inverse * (by - y_z * bz)
    det = b00 * b11 - b01 * b10
    g00, g01, g10, g11, gw0, gw1 = ZERO, ZERO, ZERO, ZERO, ZERO, ZERO
    if abs(det) > EDGE_ON * (b00 * b00 + b01 * b01 + b10 * b10 + b11 * b11):
        j00, j01, j10, j11 = splats[v, s, col.J00], splats[v, s, col.J01], splats[v, s, col.J10], splats[v, s, col.J11]
        gp0, gp1 = first[col.P0], first[col.P1]
        gw0, gw1 = -(gp0 * j00 + gp1 * j01), -(gp0 * j10 + gp1 * j11)
        h00, h01 = first[col.J00] - w0 * gp0, first[col.J01] - w0 * gp1
        h10, h11 = first[col.J10] - w1 * gp0, first[col.J11] - w1 * gp1
        # J = B^-1, so the gradient of B is -J' H J'.
        k00, k01 = j00 * h00 + j10 * h10, j00 * h01 + j10 * h11
        k10, k11 = j01 * h00 + j11 * h10, j01 * h01 + j11 * h11
        g00, g01 = -(k00 * j00 + k01 * j01), -(k00 * j10 + k01 * j11)
        g10, g11 = -(k10 * j00 + k11 * j01), -(k10 * j10 + k11 * j11)
    g00, g01, g10, g11 = fx * inverse * g00, fx * inverse * g01, fy * inverse * g10, fy * inverse * g11
    gax, gay, gaz = g00, g10, gw0 * inverse - x_z * g00 - y_z * g10
    gbx, gby, gbz = g01, g11, gw1 * inverse - x_z * g01 - y_z * g11
    # Through x / z and y / z: of the centre's image, and of B.
    gx_z = fx * first[col.XC] - g00 * az - g01 * bz
    gy_z = fy * first[col.YC] - g10 * az - g11 * bz
    gx, gy = gx_z * inverse, gy_z * inverse
    # Through the 1 / z of B and w, which are homogeneous in it.
    shrink = g00 * (ax - x_z * az) + g01 * (bx - x_z * bz) + g10 * (ay - y_z * az) + g11 * (by - y_z * bz)
    gz = first[col.Z] - inverse * (gx_z * x_z + gy_z * y_z + shrink + gw0 * w0 + gw1 * w1)
    cx, cy, cz = rotate(R[v], nx, ny, nz)
    sign = -ONE if cx * x + cy * y + cz * z > ZERO else ONE
    gnx, gny, gnz = sign * first[col.NX], sign * first[col.NY], sign * first[col.NZ]

    # Colour: harmonics, and the direction from the camera.
    own = v if sh.shape[0] > 1 else 0
    number = sh.shape[2]
    ox, oy, oz = rotate_back(R[v], t[v, 0], t[v, 1], t[v, 2])
    dx, dy, dz = px + ox, py + oy, pz + oz
    near = ONE / math.sqrt(dx * dx + dy * dy + dz * dz)
    dx, dy, dz = dx * near, dy * near, dz * near
    fill_basis(dx, dy, dz, number, basis)
    red = first[col.RED] if splats[v, s, col.RED] > ZERO else ZERO
    green = first[col.GREEN] if splats[v, s, col.GREEN] > ZERO else ZERO
    blue = first[col.BLUE] if splats[v, s, col.BLUE] > ZERO else ZERO
    for k in range(number):
        shares[k] = red * sh[own, s, k, 0] + green * sh[own, s, k, 1] + blue * sh[own, s, k, 2]
        sh_bar[own, s, k, 0] += basis[k] * red
        sh_bar[own, s, k, 1] += basis[k] * green
        sh_bar[own, s, k, 2] += basis[k] * blue
    hx, hy, hz = basis_gradient(dx, dy, dz, number, shares)
    along = hx * dx + hy * dy + hz * dz
    hx, hy, hz = near * (hx - along * dx), near * (hy - along * dy), near * (hz - along * dz)

    ex, ey, ez = rotate_back(R[v], gx, gy, gz)
    p_out[s, 0] += ex + hx
    p_out[s, 1] += ey + hy
    p_out[s, 2] += ez + hz
    au, av, aw = rotate_back(R[v], gax, gay, gaz)
    bu, bv, bw = rotate_back(R[v], gbx, gby, gbz)
    nu, nv, nw = rotate_back(R[v], gnx, gny, gnz)
    scale_out[s, 0] += scale_a * (au * ux + av * uy + aw * uz)
    scale_out[s, 1] += scale_b * (bu * vx + bv * vy + bw * vz)
    first_bar = (scale_a * au, scale_a * av, scale_a * aw)
    second_bar = (scale_b * bu, scale_b * bv, scale_b * bw)
    rw, rx, ry, rz = quaternion_gradient(qw, qx, qy, qz, first_bar, second_bar, (nu, nv, nw))
    q_out[s, 0] += rw
    q_out[s, 1] += rx
    q_out[s, 2] += ry
    q_out[s, 3] += rz
    opacity = splats[v, s, col.OPACITY]
    opacity_out[s] += first[col.OPACITY] * opacity * (ONE - opacity)

    _add_outer(R_bar, part, v, gx, gy, gz, px, py, pz)
    _add_outer(R_bar, part, v, gax, gay, gaz, scale_a * ux, scale_a * uy, scale_a * uz)
    _add_outer(R_bar, part, v, gbx, gby, gbz, scale_b * vx, scale_b * vy, scale_b * vz)
    _add_outer(R_bar, part, v, gnx, gny, gnz, nx, ny, nz)
    # The camera's place in O is -R' t.
    _add_outer(R_bar, part, v, t[v, 0], t[v, 1], t[v, 2], hx, hy, hz)
    hx, hy, hz = rotate(R[v], hx, hy, hz)
    p_bar[part, v, 0] += gx + hx
    p_bar[part, v, 1] += gy + hy
    p_bar[part, v, 2] += gz + hz
