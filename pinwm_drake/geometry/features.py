# SPDX-License-Identifier: MIT
"""Contact geometry in closed form from a pair of features, and its adjoint (numba).

The narrow phase selects which features of two bodies are closest; this file turns such a pair into gap, normal
and witness points, and pulls gradients back to the two poses. One contact is a row of 16 numbers:

    [type_A, p_A (3), u_A (3), r_A,   type_B, p_B (3), u_B (3), r_B]

with the A part in body frame A and the B part in body frame B (world frame for the floor), metres:

    POINT   p is a vertex, a sphere's centre or a capsule's end; r its rounding radius; u has no meaning
    LINE    p lies on the line, u is its unit direction; r is the rounding radius (side of a capsule or cylinder)
    PLANE   p lies in the plane, u is its outward unit normal; r is 0, or the radius of a disc about p, and the other
            feature a LINE that passes the disc's rim near its p: the contact is where it crosses the disc's cylinder
    CIRCLE  p is the centre, u the unit axis, r the radius of a sharp rim

Derivatives follow the kinematics of contact (Montana 1988): let R_A and R_B be the radius-of-curvature tensors
of the two surfaces in the tangent plane (0 across a sharp edge, r on a sphere, unbounded on a plane). Moving the
bodies by twists turns the normal by

    (R_A + R_B + phi I) dn = R_A (theta_A x n) + R_B (theta_B x n) + P (v_A(a) - v_B(b)),

slides the witness points by -R_A (dn - theta_A x n) and R_B (dn - theta_B x n), and changes the gap by
n . (v_A(a) - v_B(b)). Where a radius is unbounded (planes, along lines) its limit is taken exactly.

Source: D. J. Montana, "The kinematics of contact and grasp", IJRR 7(3), 1988, equations 17-18, here for
separated surfaces and in terms of radii instead of curvatures, so that vertices are regular.
"""

import math

from pinwm_drake.geometry.vectors import cross, dot, rotate
from pinwm_drake.jit import internal_kernel

POINT = 0
LINE = 1
PLANE = 2
CIRCLE = 3

FEATURE_SIZE = 16

_NEWTON_STEPS = 12
_TINY = 1.0e-300
_LEAST_TURN = 1.0e-6


@internal_kernel
def _across(x, y, z, u):
    """Return the unit vector of the part of a vector across the unit vector u."""
    k = dot(x, y, z, *u)
    x, y, z = x - k * u[0], y - k * u[1], z - k * u[2]
    k = 1.0 / math.sqrt(x * x + y * y + z * z + _TINY)
    return k * x, k * y, k * z


@internal_kernel
def nearest_circle_to_line(c, u, radius, p, d):
    """Point of a circle (centre c, axis u) where the distance to the line (p, d) is stationary.

    Newton's method in the circle's angle, started at the circle point nearest to p. Returns the radial unit vector.
    """
    ex, ey, ez = _across(p[0] - c[0], p[1] - c[1], p[2] - c[2], u)
    for _ in range(_NEWTON_STEPS):
        tx, ty, tz = cross(*u, ex, ey, ez)
        # w: from the line's point to the circle's point, without its part along the line.
        wx, wy, wz = c[0] + radius * ex - p[0], c[1] + radius * ey - p[1], c[2] + radius * ez - p[2]
        k = dot(wx, wy, wz, *d)
        wx, wy, wz = wx - k * d[0], wy - k * d[1], wz - k * d[2]
        td = dot(tx, ty, tz, *d)
        residual = wx * tx + wy * ty + wz * tz
        slope = radius * (1.0 - td * td) - (wx * ex + wy * ey + wz * ez)
        if slope == 0.0:
            break
        step = -residual / slope
        step = min(max(step, -0.5), 0.5)
        cs, sn = math.cos(step), math.sin(step)
        ex, ey, ez = cs * ex + sn * tx, cs * ey + sn * ty, cs * ez + sn * tz
        if abs(step) < 1e-15:
            break
    return ex, ey, ez


@internal_kernel
def _rim_point(c, u, radius, other_type, p, d):
    """Witness point of a rim (centre c, axis u) against another feature (p, d)."""
    if other_type == PLANE:
        ex, ey, ez = _across(-d[0], -d[1], -d[2], u)
    elif other_type == POINT:
        ex, ey, ez = _across(p[0] - c[0], p[1] - c[1], p[2] - c[2], u)
    else:
        ex, ey, ez = nearest_circle_to_line(c, u, radius, p, d)
    return (c[0] + radius * ex, c[1] + radius * ey, c[2] + radius * ez)


@internal_kernel
def _through_rim(p, d, c, u, radius):
    """Point of the line (p, d) nearest to p that is on the cylinder of a radius about the axis (c, u)."""
    yx, yy, yz = p[0] - c[0], p[1] - c[1], p[2] - c[2]
    k = dot(yx, yy, yz, *u)
    yx, yy, yz = yx - k * u[0], yy - k * u[1], yz - k * u[2]
    k = dot(*d, *u)
    ex, ey, ez = d[0] - k * u[0], d[1] - k * u[1], d[2] - k * u[2]
    a = ex * ex + ey * ey + ez * ez
    b = yx * ex + yy * ey + yz * ez
    c0 = yx * yx + yy * yy + yz * yz - radius * radius
    t = -c0 / (b + math.copysign(math.sqrt(max(b * b - a * c0, 0.0)), b))
    return (p[0] + t * d[0], p[1] + t * d[1], p[2] + t * d[2])


@internal_kernel
def contact_from_features(row, R_A, p_A, R_B, p_B, n, a, b):
    """Gap, normal and witness points of one feature pair.

    Args:
        row: (16,), the feature pair as described at the top of this file.
        R_A: (3, 3), R_WA.
        p_A: (3,), p_WA, m.
        R_B: (3, 3), R_WB; the identity for the floor.
        p_B: (3,), p_WB, m; zero for the floor.
        n: (3,), receives the unit normal nhat_BA_W, from B to A.
        a: (3,), receives the witness point on A's surface, world frame, m.
        b: (3,), receives the witness point on B's surface, world frame, m; a - b = phi n.

    Returns:
        The gap phi, m; negative in penetration.
    """
    type_A, type_B = int(row[0]), int(row[8])
    r_A, r_B = row[7], row[15]
    x, y, z = rotate(R_A, row[1], row[2], row[3])
    pA = (x + p_A[0], y + p_A[1], z + p_A[2])
    x, y, z = rotate(R_B, row[9], row[10], row[11])
    pB = (x + p_B[0], y + p_B[1], z + p_B[2])
    uA = rotate(R_A, row[4], row[5], row[6])
    uB = rotate(R_B, row[12], row[13], row[14])
    ra, rb = r_A, r_B

    if type_A == PLANE or type_B == PLANE:
        # A plane (p, u), with the radius of its disc, against the other feature (q, d), rounded with r.
        on_B = type_B == PLANE
        p, u, disc = (pB, uB, r_B) if on_B else (pA, uA, r_A)
        kind, q, d, r = (type_A, pA, uA, r_A) if on_B else (type_B, pB, uB, r_B)
        if kind == LINE:
            q = _through_rim(q, d, p, u, disc)
        if kind == CIRCLE:
            q = _rim_point(q, d, r, PLANE, p, u)
            r = 0.0
        gap = dot(*u, q[0] - p[0], q[1] - p[1], q[2] - p[2]) - r
        near, far, sign = (a, b, 1.0) if on_B else (b, a, -1.0)
        for i in range(3):
            n[i], near[i] = sign * u[i], q[i] - r * u[i]
            far[i] = near[i] - gap * u[i]
        return gap

    if type_A == LINE and type_B == LINE:
        cx, cy, cz = cross(*uA, *uB)
        s2 = cx * cx + cy * cy + cz * cz + _TINY
        s = 1.0 / math.sqrt(s2)
        nx, ny, nz = cx * s, cy * s, cz * s
        wx, wy, wz = pA[0] - pB[0], pA[1] - pB[1], pA[2] - pB[2]
        along_A = (dot(*uA, *uB) * dot(wx, wy, wz, *uB) - dot(wx, wy, wz, *uA)) / s2
        distance = dot(nx, ny, nz, wx, wy, wz)
        ax, ay, az = pA[0] + along_A * uA[0], pA[1] + along_A * uA[1], pA[2] + along_A * uA[2]
        n[0], n[1], n[2] = nx, ny, nz
        a[0], a[1], a[2] = ax - ra * nx, ay - ra * ny, az - ra * nz
        gap = distance - ra - rb
        b[0], b[1], b[2] = a[0] - gap * nx, a[1] - gap * ny, a[2] - gap * nz
        return gap

    if (type_A == CIRCLE and type_B == LINE) or (type_A == LINE and type_B == CIRCLE):
        # The normal is perpendicular to both the rim's tangent and the line, so that the gap keeps its sign.
        on_A = type_A == CIRCLE
        centre, axis, radius = (pA, uA, r_A) if on_A else (pB, uB, r_B)
        p, d, r = (pB, uB, r_B) if on_A else (pA, uA, r_A)
        q = _rim_point(centre, axis, radius, LINE, p, d)
        ex, ey, ez = (q[0] - centre[0]) / radius, (q[1] - centre[1]) / radius, (q[2] - centre[2]) / radius
        cx, cy, cz = cross(*cross(*axis, ex, ey, ez), *d)
        s = 1.0 / math.sqrt(cx * cx + cy * cy + cz * cz + _TINY)
        # Out of the cylinder a normal of its rim points between the radius and the axis.
        ox, oy, oz = ex + axis[0], ey + axis[1], ez + axis[2]
        if (cx * ox + cy * oy + cz * oz) * (-1.0 if on_A else 1.0) < 0.0:
            s = -s
        nx, ny, nz = cx * s, cy * s, cz * s
        distance = dot(nx, ny, nz, q[0] - p[0], q[1] - p[1], q[2] - p[2])
        n[0], n[1], n[2] = nx, ny, nz
        if on_A:
            gap = distance - r
            a[0], a[1], a[2] = q[0], q[1], q[2]
            b[0], b[1], b[2] = q[0] - gap * nx, q[1] - gap * ny, q[2] - gap * nz
        else:
            gap = -distance - r
            b[0], b[1], b[2] = q[0], q[1], q[2]
            a[0], a[1], a[2] = q[0] + gap * nx, q[1] + gap * ny, q[2] + gap * nz
        return gap

    # The remaining pairs have at least one point: the normal is along the difference of the nearest core points.
    if type_A == CIRCLE:
        pA = _rim_point(pA, uA, r_A, POINT, pB, uB)
        ra = 0.0
    elif type_B == CIRCLE:
        pB = _rim_point(pB, uB, r_B, POINT, pA, uA)
        rb = 0.0
    dx, dy, dz = pA[0] - pB[0], pA[1] - pB[1], pA[2] - pB[2]
    if type_A == LINE:
        k = dot(dx, dy, dz, *uA)
        dx, dy, dz = dx - k * uA[0], dy - k * uA[1], dz - k * uA[2]
        pA = (pB[0] + dx, pB[1] + dy, pB[2] + dz)
    elif type_B == LINE:
        k = dot(dx, dy, dz, *uB)
        dx, dy, dz = dx - k * uB[0], dy - k * uB[1], dz - k * uB[2]
    distance = math.sqrt(dx * dx + dy * dy + dz * dz + _TINY)
    nx, ny, nz = dx / distance, dy / distance, dz / distance
    gap = distance - ra - rb
    n[0], n[1], n[2] = nx, ny, nz
    a[0], a[1], a[2] = pA[0] - ra * nx, pA[1] - ra * ny, pA[2] - ra * nz
    b[0], b[1], b[2] = a[0] - gap * nx, a[1] - gap * ny, a[2] - gap * nz
    return gap


@internal_kernel
def tangents(nx, ny, nz):
    """Return the unit tangents (t1, t2), with t1 x t2 = n, smooth wherever the reference axis does not change.

    The reference axis is z unless the normal is within 26 degrees of it (then x), so that neither horizontal
    normals (a pusher) nor vertical ones (the floor) sit on the switch.
    """
    if abs(nz) < 0.9:
        s = 1.0 / math.sqrt(nx * nx + ny * ny)
        t1x, t1y, t1z = -ny * s, nx * s, 0.0
    else:
        s = 1.0 / math.sqrt(ny * ny + nz * nz)
        t1x, t1y, t1z = 0.0, -nz * s, ny * s
    return t1x, t1y, t1z, *cross(nx, ny, nz, t1x, t1y, t1z)


@internal_kernel
def tangents_adjoint(nx, ny, nz, t1, t1bar, t2bar):
    """Pull gradients of the two tangents back to the normal; return the three components of nbar."""
    # t2 = n x t1
    b1x = t1bar[0] + t2bar[1] * nz - t2bar[2] * ny
    b1y = t1bar[1] + t2bar[2] * nx - t2bar[0] * nz
    b1z = t1bar[2] + t2bar[0] * ny - t2bar[1] * nx
    gx, gy, gz = cross(t1[0], t1[1], t1[2], t2bar[0], t2bar[1], t2bar[2])
    # t1 = e x n / |e x n|
    k = b1x * t1[0] + b1y * t1[1] + b1z * t1[2]
    b1x, b1y, b1z = b1x - k * t1[0], b1y - k * t1[1], b1z - k * t1[2]
    if abs(nz) < 0.9:
        s = 1.0 / math.sqrt(nx * nx + ny * ny)
        gx += s * b1y
        gy -= s * b1x
    else:
        s = 1.0 / math.sqrt(ny * ny + nz * nz)
        gy += s * b1z
        gz -= s * b1y
    return gx, gy, gz


@internal_kernel
def _radii(kind, outward, ux, uy, uz, r, ex, ey, ez, t1, t2):
    """Radius-of-curvature tensor of a surface in the tangent basis; (ex, ey, ez) is a - p.

    `outward` is the sign of the surface's outward normal along n.

    Returns its finite part (r11, r12, r22), and for a line its direction (w1, w2), along which the surface is flat.
    A plane, flat in both directions, is left to the caller.
    """
    w1, w2 = dot(ux, uy, uz, *t1), dot(ux, uy, uz, *t2)
    if kind == LINE:
        # Across its direction a line is rounded with r.
        return r * w2 * w2, -r * w1 * w2, r * w1 * w1, w1, w2
    if kind == CIRCLE:
        # Along the rim's tangent the outward normal turns by cos(alpha) / r per metre; across, it turns freely.
        s = 1.0 / math.sqrt(ex * ex + ey * ey + ez * ez + _TINY)
        ex, ey, ez = ex * s, ey * s, ez * s
        # A normal along the axis does not turn at all; the bound keeps what cancels within rounding.
        turn = outward * dot(*cross(*t1, *t2), ex, ey, ez)
        k = r / (turn if abs(turn) > _LEAST_TURN else _LEAST_TURN)
        ux, uy, uz = cross(ux, uy, uz, ex, ey, ez)
        w1, w2 = dot(ux, uy, uz, *t1), dot(ux, uy, uz, *t2)
        return k * w1 * w1, k * w1 * w2, k * w2 * w2, 0.0, 0.0
    return r, 0.0, r, 0.0, 0.0


@internal_kernel
def _add_twist(out, x, y, z, fx, fy, fz):
    out[0], out[1], out[2] = out[0] + x, out[1] + y, out[2] + z
    out[3], out[4], out[5] = out[3] + fx, out[4] + fy, out[5] + fz


@internal_kernel
def _crossing_adjoint(d, x, r, p_L, R_P, p_P, plane, sign, phi, nbar, cbar, phibar, twist_L, twist_P):
    """`contact_adjoint` for a line of body L, rounded with r, that crosses the rim of a disc of body P at x.

    In P, x slides along the line's direction d so that it stays on the rim's cylinder, whose radial unit vector is e:
    with s the velocity of the line's material in P, by -(e . s) / (e . d), and the gap by u . s plus what it slides.
    `sign` is +1 where the row's normal is the plane's u.
    """
    u = rotate(R_P, plane[4], plane[5], plane[6])
    cx, cy, cz = rotate(R_P, plane[1], plane[2], plane[3])
    ex, ey, ez = _across(x[0] - p_P[0] - cx, x[1] - p_P[1] - cy, x[2] - p_P[2] - cz, u)
    ed = dot(ex, ey, ez, *d)
    slope = dot(*u, *d) / ed
    # The contact point is x - (r + phi / 2) u.
    g = phibar - 0.5 * dot(cbar[0], cbar[1], cbar[2], *u)
    k = dot(cbar[0], cbar[1], cbar[2], *d) / ed
    sx, sy = g * (u[0] - slope * ex) - k * ex, g * (u[1] - slope * ey) - k * ey
    sz = g * (u[2] - slope * ez) - k * ez
    fx, fy, fz = cbar[0] + sx, cbar[1] + sy, cbar[2] + sz
    lx, ly, lz = x[0] - p_L[0], x[1] - p_L[1], x[2] - p_L[2]
    _add_twist(twist_L, *cross(lx, ly, lz, fx, fy, fz), fx, fy, fz)
    lx, ly, lz = x[0] - p_P[0], x[1] - p_P[1], x[2] - p_P[2]
    k = r + 0.5 * phi
    wx, wy, wz = sign * nbar[0] - k * cbar[0], sign * nbar[1] - k * cbar[1], sign * nbar[2] - k * cbar[2]
    wx, wy, wz = cross(*u, wx, wy, wz)
    lx, ly, lz = cross(lx, ly, lz, sx, sy, sz)
    _add_twist(twist_P, wx - lx, wy - ly, wz - lz, -sx, -sy, -sz)


@internal_kernel
def contact_adjoint(row, R_A, p_A, R_B, p_B, n, a, b, phi, nbar, cbar, phibar, twist_A, twist_B):
    """Pull gradients of a contact back to the poses of its two bodies.

    Args:
        row, R_A, p_A, R_B, p_B, n, a, b: as for `contact_from_features`, n, a and b as it wrote them.
        phi: the gap it returned, m.
        nbar: (3,), gradient with respect to the normal nhat_BA_W.
        cbar: (3,), gradient with respect to the contact point c = (a + b) / 2, world frame.
        phibar: gradient with respect to the gap.
        twist_A: (6,), gains the gradient with respect to A's pose as [rotation vector; translation], world frame,
            for R_WA -> exp(theta) R_WA and p_WA -> p_WA + delta.
        twist_B: (6,), the same for B.
    """
    kind_A, kind_B = int(row[0]), int(row[8])
    if kind_A == LINE and kind_B == PLANE:
        d, x = rotate(R_A, row[4], row[5], row[6]), (a[0] + row[7] * n[0], a[1] + row[7] * n[1], a[2] + row[7] * n[2])
        _crossing_adjoint(d, x, row[7], p_A, R_B, p_B, row[8:16], 1.0, phi, nbar, cbar, phibar, twist_A, twist_B)
        return
    if kind_A == PLANE and kind_B == LINE:
        d = rotate(R_B, row[12], row[13], row[14])
        x = (b[0] - row[15] * n[0], b[1] - row[15] * n[1], b[2] - row[15] * n[2])
        _crossing_adjoint(d, x, row[15], p_B, R_A, p_A, row[0:8], -1.0, phi, nbar, cbar, phibar, twist_B, twist_A)
        return
    t1x, t1y, t1z, t2x, t2y, t2z = tangents(n[0], n[1], n[2])
    t1, t2 = (t1x, t1y, t1z), (t2x, t2y, t2z)
    ux, uy, uz = rotate(R_A, row[4], row[5], row[6])
    px, py, pz = rotate(R_A, row[1], row[2], row[3])
    A11, A12, A22, u1, u2 = _radii(
        kind_A, -1.0, ux, uy, uz, row[7], a[0] - p_A[0] - px, a[1] - p_A[1] - py, a[2] - p_A[2] - pz, t1, t2
    )
    ux, uy, uz = rotate(R_B, row[12], row[13], row[14])
    px, py, pz = rotate(R_B, row[9], row[10], row[11])
    B11, B12, B22, w1, w2 = _radii(
        kind_B, 1.0, ux, uy, uz, row[15], b[0] - p_B[0] - px, b[1] - p_B[1] - py, b[2] - p_B[2] - pz, t1, t2
    )
    # Gradient of the witness points' sliding, the same for both.
    s1 = 0.5 * (cbar[0] * t1x + cbar[1] * t1y + cbar[2] * t1z)
    s2 = 0.5 * (cbar[0] * t2x + cbar[1] * t2y + cbar[2] * t2z)
    n1, n2 = nbar[0] * t1x + nbar[1] * t1y + nbar[2] * t1z, nbar[0] * t2x + nbar[1] * t2y + nbar[2] * t2z
    As1, As2 = A11 * s1 + A12 * s2, A12 * s1 + A22 * s2
    Bs1, Bs2 = B11 * s1 + B12 * s2, B12 * s1 + B22 * s2
    # (m1, m2): gradient with respect to P (v_A(a) - v_B(b)); (tA1, tA2): with respect to theta_A x n; tB likewise.
    if kind_B == PLANE:
        # dn = theta_B x n, and B's witness point follows A's.
        m1, m2 = s1, s2
        tA1, tA2 = 2.0 * As1, 2.0 * As2
        tB1, tB2 = n1 - phi * s1 - tA1, n2 - phi * s2 - tA2
    elif kind_A == PLANE:
        m1, m2 = -s1, -s2
        tB1, tB2 = -2.0 * Bs1, -2.0 * Bs2
        tA1, tA2 = n1 + phi * s1 - tB1, n2 + phi * s2 - tB2
    else:
        g11, g12, g22 = A11 + B11 + phi, A12 + B12, A22 + B22 + phi
        d1, d2 = n1 - As1 + Bs1, n2 - As2 + Bs2
        hold_A, hold_B = 0.0, 0.0
        if kind_A == LINE and kind_B == LINE:
            # Both lines hold the normal: u . m = -u . s, w . m = w . s; hold_A, hold_B are the forces of that.
            sine = u1 * w2 - u2 * w1
            us, ws = (u1 * s1 + u2 * s2) / sine, (w1 * s1 + w2 * s2) / sine
            m1, m2 = -ws * u2 - us * w2, ws * u1 + us * w1
            e1, e2 = d1 - g11 * m1 - g12 * m2, d2 - g12 * m1 - g22 * m2
            hold_A, hold_B = (e1 * w2 - e2 * w1) / sine, (e2 * u1 - e1 * u2) / sine
        elif kind_A == LINE or kind_B == LINE:
            sign = -1.0
            if kind_B == LINE:
                u1, u2, sign = w1, w2, 1.0
            us = sign * (u1 * s1 + u2 * s2)
            across = g11 * u2 * u2 - 2.0 * g12 * u1 * u2 + g22 * u1 * u1
            coupling = (g22 - g11) * u1 * u2 + g12 * (u1 * u1 - u2 * u2)
            q = (d2 * u1 - d1 * u2 - us * coupling) / across
            m1, m2 = us * u1 - q * u2, us * u2 + q * u1
            force = u1 * (d1 - g11 * m1 - g12 * m2) + u2 * (d2 - g12 * m1 - g22 * m2)
            if kind_B == LINE:
                hold_B = force
            else:
                hold_A = force
        else:
            det = g11 * g22 - g12 * g12
            if abs(det) < _TINY:
                det = math.copysign(_TINY, det)
            m1, m2 = (g22 * d1 - g12 * d2) / det, (g11 * d2 - g12 * d1) / det
        tA1, tA2 = As1 + A11 * m1 + A12 * m2 + hold_A * u1, As2 + A12 * m1 + A22 * m2 + hold_A * u2
        tB1, tB2 = -Bs1 + B11 * m1 + B12 * m2 + hold_B * w1, -Bs2 + B12 * m1 + B22 * m2 + hold_B * w2
    mx, my, mz = m1 * t1x + m2 * t2x, m1 * t1y + m2 * t2y, m1 * t1z + m2 * t2z

    vx, vy, vz = phibar * n[0] + mx, phibar * n[1] + my, phibar * n[2] + mz
    for side in range(2):
        if side == 0:
            gx, gy, gz = 0.5 * cbar[0] + vx, 0.5 * cbar[1] + vy, 0.5 * cbar[2] + vz
            rx, ry, rz = a[0] - p_A[0], a[1] - p_A[1], a[2] - p_A[2]
            q1, q2, out = tA1, tA2, twist_A
        else:
            gx, gy, gz = 0.5 * cbar[0] - vx, 0.5 * cbar[1] - vy, 0.5 * cbar[2] - vz
            rx, ry, rz = b[0] - p_B[0], b[1] - p_B[1], b[2] - p_B[2]
            q1, q2, out = tB1, tB2, twist_B
        # w . (theta x n) = theta . (n x w), with n x t1 = t2 and n x t2 = -t1.
        rx, ry, rz = cross(rx, ry, rz, gx, gy, gz)
        rx, ry, rz = rx + q1 * t2x - q2 * t1x, ry + q1 * t2y - q2 * t1y, rz + q1 * t2z - q2 * t1z
        _add_twist(out, rx, ry, rz, gx, gy, gz)
