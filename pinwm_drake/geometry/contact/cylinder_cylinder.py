# SPDX-License-Identifier: MIT
"""Two cylinders against each other (numba).

The method of `cylinder_hull`: a search names the features, and the pair of features with the largest separation along
its normal, known in closed form or by Newton's method for two rims, is the contact.
"""

import math

import numpy as np

from pinwm_drake.geometry.contact.cylinder_manifold import collect_cylinder_manifold
from pinwm_drake.geometry.contact.cylinder_parts import rim_line, write_cap, write_rim, write_rim_line, write_rim_place
from pinwm_drake.geometry.contact.epa import expand
from pinwm_drake.geometry.contact.face_clip import DEEPER
from pinwm_drake.geometry.contact.gjk import distance
from pinwm_drake.geometry.contact.segments import SAME
from pinwm_drake.geometry.contact.support import separation_along
from pinwm_drake.geometry.features import LINE, PLANE, POINT
from pinwm_drake.geometry.rows import write_line_pair, write_part
from pinwm_drake.geometry.vectors import (
    PARALLEL_SINE,
    cross,
    dot,
    inverse_pose,
    norm,
    radial,
    transform,
    turn,
    turn_back,
    xyz,
)
from pinwm_drake.jit import allocating_kernel, internal_kernel

# As in `cylinder_hull`, m.
_TOLERANCE = 1.0e-8
_APART = 1.0e-6
# Pairs of features, that of the first cylinder first.
RIM_CAP, CAP_RIM, SIDE_SIDE, RIM_SIDE, SIDE_RIM, RIM_RIM = 0, 1, 2, 3, 4, 5
_CANDIDATES = 8
_NEWTON_STEPS = 20
# Closer to an axis than this [rad] the normal of two rims is taken for that of a cap: at a distance of 0.1 m this
# changes the gap by less than 1e-13 m.
_MIN_SINE = 1.0e-6


@allocating_kernel
def collide_cylinders(table, one, two, X_21, column, margin, rows, count):
    """Append the contacts of two cylinders; arguments as for `segments.collide_rounds`."""
    ends = np.empty((4, 2), np.int64)
    apart, nx, ny, nz = expand(table, one, two, X_21, margin, _TOLERANCE, ends)
    if apart >= margin:
        return count
    if apart > _APART:
        _, nx, ny, nz, _ = distance(table, one, two, X_21, nx, ny, nz, _TOLERANCE, ends)
    ax, ay, az = nx, ny, nz
    X_12 = inverse_pose(X_21)
    apart, pair, end_1, end_2 = -math.inf, RIM_CAP, 0, 0
    for k in range(_CANDIDATES):
        p, e, g, mx, my, mz = _candidate(table, one, two, X_21, X_12, k, ax, ay, az)
        if p < 0:
            continue
        d = separation_along(table, one, two, X_21, mx, my, mz)
        if d > apart + SAME:
            apart, pair, end_1, end_2 = d, p, e, g
            nx, ny, nz = mx, my, mz
    if apart >= margin:
        return count
    count, nearest = collect_cylinder_manifold(
        table, one, two, X_21, X_12, nx, ny, nz, apart - DEEPER, column, margin, rows, count
    )
    if apart < nearest - SAME and count < rows.shape[0]:
        _write(table, one, two, X_21, X_12, nx, ny, nz, pair, end_1, end_2, rows, count, column)
        count += 1
    return count


@internal_kernel
def _candidate(table, one, two, X_21, X_12, k, nx, ny, nz):
    """Candidate number k near the axis n: pair of features (-1: none), the ends of both, and its normal."""
    ux, uy, uz = turn(X_21, *xyz(table.axes, one))
    vx, vy, vz = xyz(table.axes, two)
    along_1, along_2 = dot(nx, ny, nz, ux, uy, uz), dot(nx, ny, nz, vx, vy, vz)
    end_1, end_2 = 0 if along_1 > 0.0 else 1, 1 if along_2 > 0.0 else 0
    none = -1
    if k == 0:
        sign = 2.0 * end_2 - 1.0
        end_1 = 0 if sign * dot(ux, uy, uz, vx, vy, vz) > 0.0 else 1
        return RIM_CAP, end_1, end_2, sign * vx, sign * vy, sign * vz
    if k == 1:
        sign = 1.0 - 2.0 * end_1
        end_2 = 1 if sign * dot(ux, uy, uz, vx, vy, vz) > 0.0 else 0
        return CAP_RIM, end_1, end_2, sign * ux, sign * uy, sign * uz
    if k == 2:
        mx, my, mz = cross(ux, uy, uz, vx, vy, vz)
        if norm(mx, my, mz) < PARALLEL_SINE:
            cx, cy, cz = xyz(table.piece_spheres, two)
            px, py, pz = transform(X_21, *xyz(table.piece_spheres, one))
            mx, my, mz, _ = radial(vx, vy, vz, px - cx, py - cy, pz - cz)
        length = math.copysign(norm(mx, my, mz), dot(mx, my, mz, nx, ny, nz))
        if length == 0.0:
            return none, 0, 0, nx, ny, nz
        return SIDE_SIDE, end_1, end_2, mx / length, my / length, mz / length
    if k < 5:
        # A rim of the first against the axis of the second, in the frame of the first.
        px, py, pz = transform(X_12, *xyz(table.vertices, table.pieces[two, 1]))
        dx, dy, dz = turn(X_12, vx, vy, vz)
        mx, my, mz = turn_back(X_21, -nx, -ny, -nz)
        mx, my, mz, _, _ = rim_line(table, one, k - 3, px, py, pz, dx, dy, dz, mx, my, mz)
        mx, my, mz = turn(X_21, -mx, -my, -mz)
        # Not a number, or a normal on which the other rim lies farther out.
        if not (7.0 - 2.0 * k) * dot(mx, my, mz, ux, uy, uz) > -SAME:
            return none, 0, 0, nx, ny, nz
        return RIM_SIDE, k - 3, end_2, mx, my, mz
    if k < 7:
        px, py, pz = transform(X_21, *xyz(table.vertices, table.pieces[one, 1]))
        mx, my, mz, _, _ = rim_line(table, two, k - 5, px, py, pz, ux, uy, uz, nx, ny, nz)
        if not (2.0 * k - 11.0) * dot(mx, my, mz, vx, vy, vz) > -SAME:
            return none, 0, 0, nx, ny, nz
        return SIDE_RIM, end_1, k - 5, mx, my, mz
    mx, my, mz = _two_rims(table, one, two, X_21, end_1, end_2, nx, ny, nz)
    outward = min((1.0 - 2.0 * end_1) * dot(mx, my, mz, ux, uy, uz), (2.0 * end_2 - 1.0) * dot(mx, my, mz, vx, vy, vz))
    if not outward > -SAME:
        return none, 0, 0, nx, ny, nz
    return RIM_RIM, end_1, end_2, mx, my, mz


@internal_kernel
def _two_rims(table, one, two, X_21, end_1, end_2, nx, ny, nz):
    """Return the normal of largest separation of two rims near n, by Newton's method on the sphere; NaN if none.

    The separation is f = n . (a - b) with the farthest points a and b of the rims. Its gradient in the
    tangent plane is that of a - b there, and its Hessian -r_1 t_1 t_1' / s_1 - r_2 t_2 t_2' / s_2 - f I, with
    the tangents t of the rims and the sines s of n against their axes.
    """
    ux, uy, uz = turn(X_21, *xyz(table.axes, one))
    vx, vy, vz = xyz(table.axes, two)
    px, py, pz = transform(X_21, *xyz(table.vertices, table.pieces[one, 1] + end_1))
    qx, qy, qz = xyz(table.vertices, table.pieces[two, 1] + end_2)
    r_1, r_2 = table.vertices[table.pieces[one, 1], 3], table.vertices[table.pieces[two, 1], 3]
    for _ in range(_NEWTON_STEPS):
        ex, ey, ez, s_1 = radial(ux, uy, uz, -nx, -ny, -nz)
        fx, fy, fz, s_2 = radial(vx, vy, vz, nx, ny, nz)
        if s_1 < _MIN_SINE or s_2 < _MIN_SINE:
            return math.nan, 0.0, 0.0
        wx, wy = px + r_1 * ex - qx - r_2 * fx, py + r_1 * ey - qy - r_2 * fy
        wz = pz + r_1 * ez - qz - r_2 * fz
        tx, ty, tz = cross(ux, uy, uz, ex, ey, ez)
        sx, sy, sz = cross(vx, vy, vz, fx, fy, fz)
        # A basis of the tangent plane: across n and the first axis, and across both.
        bx, by, bz = cross(nx, ny, nz, ux, uy, uz)
        size = norm(bx, by, bz)
        bx, by, bz = bx / size, by / size, bz / size
        cx, cy, cz = cross(nx, ny, nz, bx, by, bz)
        f = dot(nx, ny, nz, wx, wy, wz)
        t_b, t_c = dot(tx, ty, tz, bx, by, bz), dot(tx, ty, tz, cx, cy, cz)
        s_b, s_c = dot(sx, sy, sz, bx, by, bz), dot(sx, sy, sz, cx, cy, cz)
        h_bb = r_1 / s_1 * t_b * t_b + r_2 / s_2 * s_b * s_b + f
        h_bc = r_1 / s_1 * t_b * t_c + r_2 / s_2 * s_b * s_c
        h_cc = r_1 / s_1 * t_c * t_c + r_2 / s_2 * s_c * s_c + f
        g_b, g_c = dot(wx, wy, wz, bx, by, bz), dot(wx, wy, wz, cx, cy, cz)
        det = h_bb * h_cc - h_bc * h_bc
        if h_bb <= 0.0 or det <= 0.0:
            return math.nan, 0.0, 0.0
        d_b, d_c = (h_cc * g_b - h_bc * g_c) / det, (h_bb * g_c - h_bc * g_b) / det
        step = math.sqrt(d_b * d_b + d_c * d_c)
        shorter = min(1.0, 0.2 / (step + 1.0e-300))
        d_b, d_c = shorter * d_b, shorter * d_c
        nx, ny, nz = nx + d_b * bx + d_c * cx, ny + d_b * by + d_c * cy, nz + d_b * bz + d_c * cz
        size = norm(nx, ny, nz)
        nx, ny, nz = nx / size, ny / size, nz / size
        if step < 1.0e-14:
            break
    return nx, ny, nz


@internal_kernel
def _write(table, one, two, X_21, X_12, nx, ny, nz, pair, end_1, end_2, rows, count, column):
    """Write the pair of features."""
    i, j = table.pieces[one, 1], table.pieces[two, 1]
    ux, uy, uz = turn(X_21, *xyz(table.axes, one))
    vx, vy, vz = xyz(table.axes, two)
    _, _, _, sine = radial(ux, uy, uz, vx, vy, vz)
    mx, my, mz = turn_back(X_21, -nx, -ny, -nz)
    if pair == RIM_CAP:
        if sine > PARALLEL_SINE:
            write_rim(table, one, end_1, rows, count, column)
        else:
            write_rim_place(table, one, end_1, 0, rows, count, column)
        write_cap(table, two, end_2, rows, count, 8 - column)
    elif pair == CAP_RIM:
        write_cap(table, one, end_1, rows, count, column)
        if sine > PARALLEL_SINE:
            write_rim(table, two, end_2, rows, count, 8 - column)
        else:
            write_rim_place(table, two, end_2, 0, rows, count, 8 - column)
    elif pair == SIDE_SIDE and sine > PARALLEL_SINE:
        write_line_pair(table, i, i + 1, j, j + 1, X_21, nx, ny, nz, rows, count, column)
    elif pair == SIDE_RIM:
        write_rim_line(table, two, end_2, i, i + 1, X_21, nx, ny, nz, rows, count, 8 - column)
    elif pair == RIM_RIM:
        _write_two_rims(table, i + end_1, j + end_2, one, two, X_21, nx, ny, nz, end_1, rows, count, column)
    else:
        write_rim_line(table, one, end_1, j, j + 1, X_12, mx, my, mz, rows, count, column)


@internal_kernel
def _write_two_rims(table, c, d, one, two, X_21, nx, ny, nz, end_1, rows, count, column):
    """Write two rims (centres c and d) as a circle and the other's tangent, or as a point and a plane.

    A rim whose axis the normal nearly follows, or along which the other's tangent runs, is no use as a circle.
    """
    vx, vy, vz = xyz(table.axes, two)
    ux, uy, uz = xyz(table.axes, one)
    mx, my, mz = turn_back(X_21, -nx, -ny, -nz)
    ex, ey, ez, sine_1 = radial(ux, uy, uz, mx, my, mz)
    fx, fy, fz, sine_2 = radial(vx, vy, vz, nx, ny, nz)
    sx, sy, sz = cross(ux, uy, uz, ex, ey, ez)
    tx, ty, tz = cross(vx, vy, vz, fx, fy, fz)
    px, py, pz = xyz(table.vertices, c)
    qx, qy, qz = xyz(table.vertices, d)
    r_1, r_2 = table.vertices[c, 3], table.vertices[d, 3]
    px, py, pz = px + r_1 * ex, py + r_1 * ey, pz + r_1 * ez
    qx, qy, qz = qx + r_2 * fx, qy + r_2 * fy, qz + r_2 * fz
    crossing = norm(*cross(*turn(X_21, sx, sy, sz), tx, ty, tz))
    if crossing > PARALLEL_SINE and max(sine_1, sine_2) > PARALLEL_SINE:
        if sine_1 >= sine_2:
            write_rim(table, one, end_1, rows, count, column)
            write_part(rows, count, 8 - column, LINE, qx, qy, qz, tx, ty, tz, 0.0)
        else:
            write_part(rows, count, column, LINE, px, py, pz, sx, sy, sz, 0.0)
            write_rim(table, two, d - table.pieces[two, 1], rows, count, 8 - column)
    else:
        write_part(rows, count, column, POINT, px, py, pz, 0.0, 0.0, 0.0, 0.0)
        write_part(rows, count, 8 - column, PLANE, qx, qy, qz, nx, ny, nz, 0.0)
