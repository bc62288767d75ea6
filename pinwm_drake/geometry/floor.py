# SPDX-License-Identifier: MIT
"""Contacts of a body with the horizontal plane of the floor (numba)."""

import math

from pinwm_drake.geometry.contact.cylinder_parts import rim_axes
from pinwm_drake.geometry.features import CIRCLE, PLANE, POINT
from pinwm_drake.geometry.pieces import (
    ANYHOW,
    CYLINDER,
    IF_FLAT,
    IF_LYING,
    MAX_FLOOR_POINTS,
    RIM_CORNERS,
    UNLESS_FLAT,
)
from pinwm_drake.geometry.rows import write_part
from pinwm_drake.geometry.vectors import dot, norm, rotate_back, xyz
from pinwm_drake.jit import internal_kernel, large_internal_kernel

_DIRECTIONS = 8
_DIRECTION_COS = tuple(math.cos(2.0 * math.pi * k / _DIRECTIONS) for k in range(_DIRECTIONS))
_DIRECTION_SIN = tuple(math.sin(2.0 * math.pi * k / _DIRECTIONS) for k in range(_DIRECTIONS))

# The reduction keeps the deepest point only where it is deeper than the outermost ones by more than this [m]:
# points of a face that lies flat on the floor differ by rounding, and the choice must not follow that.
_SAME_DEPTH = 1.0e-7

# Sine of the tilt, off standing or lying, above which a rim touches with its corners. Those below it would be chosen by
# rounding; the points fixed on the rim are too high by 0.08 radius * tilt at most.
_MIN_TILT = 1.0e-4
# The round side of a cylinder ends this share of the radius before each rim, but at most a quarter of the length. So
# one that lies rolls on what is round, and one that tips lies on a corner from 0.06 rad on.
_INSET, _MOST_INSET = 0.02, 0.25
# Sine of the tilt off lying from which on the round side is beyond reach: a corner is lower by 0.28 % of the radius.
LYING = 0.2
# Places that are nearer than this are the same corner, m.
_SAME_PLACE = 1.0e-9

# The fixed points serve a cylinder that stands. Off 0.2 rad they would only make a rolling cylinder a
# polygon.
_MAX_STANDING_TILT = 0.2

# Cosines of the tilts up to which a face lies on the floor, and is nearly on it (2e-3 and 0.1 rad).
_FLAT, _NEARLY_FLAT = 1.0 - 2.0e-6, 0.995


@large_internal_kernel
def collide_floor(table, body, spread, R_WB, p_WB, V, h, floor_height, margin, rows, count):
    """Append the contacts of one body (A) with the floor (B).

    In the row of a fixed point, the x of the unused direction is its number in `table.floor_points`, or -1
    for a corner of a rim.

    Args:
        table: PieceTable.
        body: Index of the body.
        spread: (3,), factors of the spread of a face's points, see `spread_point`.
        R_WB: (3, 3), its rotation.
        p_WB: (3,), its position, m, world frame.
        V: (6,), its velocity, [rad/s; m/s].
        h: Time for which contacts are sought, s.
        floor_height: z of the floor, m, world frame.
        margin: Contacts with a gap below this are appended, m.
        rows: (max_contacts, 16), receives feature rows from row `count` on.
        count: Rows already used.

    Returns:
        Rows used now; never more than there are.
    """
    # z of a point p of the body is (ux, uy, uz) . p + lift above the floor.
    ux, uy, uz = R_WB[2, 0], R_WB[2, 1], R_WB[2, 2]
    lift = p_WB[2] - floor_height
    cx, cy, cz = xyz(table.body_spheres, body)
    if dot(ux, uy, uz, cx, cy, cz) + lift - table.body_spheres[body, 3] >= margin:
        return count
    # The change of a point's height in that time is (dx, dy, dz) . p + fall.
    dx, dy, dz = rotate_back(R_WB, -h * V[1], h * V[0], 0.0)
    later = (ux + dx, uy + dy, uz + dz, lift + h * V[5])
    # The points of a face or line carry it together, none of them can stand for others.
    for i in range(table.bodies[body, 1], table.bodies[body + 1, 1]):
        if table.floor_owners[i] <= IF_FLAT and _gap(table, i, spread, ux, uy, uz, lift) < margin:
            count = _append_point(table, i, spread, floor_height, rows, count)
    first = count
    for i in range(table.bodies[body, 1], table.bodies[body + 1, 1]):
        if table.floor_owners[i] > IF_FLAT and _gap(table, i, spread, ux, uy, uz, lift) < margin:
            if count - first == MAX_FLOOR_POINTS:
                count = _reduce(table, body, spread, ux, uy, uz, lift, later, floor_height, margin, rows, first)
                break
            count = _append_point(table, i, spread, floor_height, rows, count)
    for piece in range(table.bodies[body, 0], table.bodies[body + 1, 0]):
        if table.pieces[piece, 0] == CYLINDER:
            count = _append_rims(table, piece, ux, uy, uz, lift, later, floor_height, margin, rows, first, count)
    return count


@internal_kernel
def spread_point(table, i, spread):
    """Floor point with the pressure on its face or line spread by factors (3,) along the axes of B: (x, y, z), m.

    It goes from x to x + P (D - 1) r: D = diag(spread), r is its place about the foot of B's origin on the face or
    line, and P projects onto that. Other points stay.
    """
    x, y, z = xyz(table.floor_points, i)
    if table.floor_owners[i] > IF_FLAT:
        return x, y, z
    nx, ny, nz = xyz(table.floor_faces, i)
    k = dot(nx, ny, nz, x, y, z)
    if table.floor_owners[i] == IF_LYING:
        k *= (spread[0] - 1.0) * nx * nx + (spread[1] - 1.0) * ny * ny + (spread[2] - 1.0) * nz * nz
        return x + k * nx, y + k * ny, z + k * nz
    ex, ey, ez = (spread[0] - 1.0) * (x - k * nx), (spread[1] - 1.0) * (y - k * ny), (spread[2] - 1.0) * (z - k * nz)
    k = dot(nx, ny, nz, ex, ey, ez)
    return x + ex - k * nx, y + ey - k * ny, z + ez - k * nz


@internal_kernel
def spread_adjoint(table, i, gx, gy, gz, bar):
    """Adjoint of `spread_point`: adds to bar (3,) the gradient by the factors, from that (gx, gy, gz) by the point."""
    if i < 0 or table.floor_owners[i] > IF_FLAT:
        return
    x, y, z = xyz(table.floor_points, i)
    nx, ny, nz = xyz(table.floor_faces, i)
    k, g = dot(nx, ny, nz, x, y, z), dot(nx, ny, nz, gx, gy, gz)
    if table.floor_owners[i] == IF_LYING:
        bar[0] += k * nx * nx * g
        bar[1] += k * ny * ny * g
        bar[2] += k * nz * nz * g
        return
    bar[0] += (x - k * nx) * (gx - g * nx)
    bar[1] += (y - k * ny) * (gy - g * ny)
    bar[2] += (z - k * nz) * (gz - g * nz)


@internal_kernel
def _gap(table, i, spread, ux, uy, uz, lift):
    """Gap of one floor point [m]; infinite for one that cannot touch the floor as the body lies."""
    piece = table.floor_owners[i]
    if piece < ANYHOW:
        nx, ny, nz = xyz(table.floor_faces, i)
        down = -dot(nx, ny, nz, ux, uy, uz)
        if piece == IF_LYING:
            if abs(down) > LYING:
                return math.inf
        elif (down > _FLAT) if piece == UNLESS_FLAT else (down < _NEARLY_FLAT):
            return math.inf
    if piece >= 0:
        ax, ay, az = xyz(table.axes, piece)
        upright = dot(ax, ay, az, ux, uy, uz)
        if 1.0 - upright * upright > _MAX_STANDING_TILT * _MAX_STANDING_TILT:
            return math.inf
    x, y, z = spread_point(table, i, spread)
    return dot(ux, uy, uz, x, y, z) + lift - table.floor_points[i, 3]


@internal_kernel
def _append_point(table, i, spread, floor_height, rows, count):
    if count >= rows.shape[0]:
        return count
    x, y, z = spread_point(table, i, spread)
    write_part(rows, count, 0, POINT, x, y, z, float(i), 0.0, 0.0, table.floor_points[i, 3])
    write_part(rows, count, 8, PLANE, 0.0, 0.0, floor_height, 0.0, 0.0, 1.0, 0.0)
    return count + 1


@internal_kernel
def _reduce(table, body, spread, ux, uy, uz, lift, later, floor_height, margin, rows, count):
    """Append, of the points of no face, those lowest when the body tilts in eight directions, and the deepest.

    It tilts by as much as takes it through the margin, so that the points that a step may bring to the floor are among
    them; of a face that lies flat they are the outermost ones. The directions lie in the coordinate plane of the body
    that is most nearly horizontal, so that the choice changes little while the body turns. Those lowest at the end of
    the step are appended as well, where the body tilts by a quarter of that: what rolls lands on them.
    """
    start, end = table.bodies[body, 1], table.bodies[body + 1, 1]
    first_axis, second_axis = 0, 1
    if abs(ux) > abs(uz) and abs(ux) >= abs(uy):
        first_axis, second_axis = 1, 2
    elif abs(uy) > abs(uz):
        first_axis, second_axis = 0, 2
    first = count
    if first + 2 * _DIRECTIONS >= rows.shape[0]:
        return rows.shape[0]
    tilt = margin / table.body_spheres[body, 3]
    # The rows to come hold what is best so far: point and height of each direction.
    for k in range(2 * _DIRECTIONS):
        rows[first + k, 0], rows[first + k, 1] = -1.0, math.inf
    deepest, depth = -1, math.inf
    for i in range(start, end):
        gap = math.inf if table.floor_owners[i] <= IF_FLAT else _gap(table, i, spread, ux, uy, uz, lift)
        if gap >= margin:
            continue
        if gap < depth - _SAME_DEPTH:
            deepest, depth = i, gap
        x, y = table.floor_points[i, first_axis], table.floor_points[i, second_axis]
        px, py, pz = spread_point(table, i, spread)
        end_gap = dot(later[0], later[1], later[2], px, py, pz) + later[3] - table.floor_points[i, 3]
        for k in range(_DIRECTIONS):
            out = tilt * (_DIRECTION_COS[k] * x + _DIRECTION_SIN[k] * y)
            if gap - out < rows[first + k, 1]:
                rows[first + k, 0], rows[first + k, 1] = float(i), gap - out
            if end_gap - 0.25 * out < rows[first + _DIRECTIONS + k, 1]:
                rows[first + _DIRECTIONS + k, 0] = float(i)
                rows[first + _DIRECTIONS + k, 1] = end_gap - 0.25 * out
    lowest_kept = math.inf
    for k in range(2 * _DIRECTIONS):
        outermost = int(rows[first + k, 0])
        known = False
        for row in range(first, count):
            known = known or rows[row, 4] == outermost
        if not known:
            count = _append_point(table, outermost, spread, floor_height, rows, count)
            lowest_kept = min(lowest_kept, _gap(table, outermost, spread, ux, uy, uz, lift))
    if depth < lowest_kept - _SAME_DEPTH:
        count = _append_point(table, deepest, spread, floor_height, rows, count)
    return count


@internal_kernel
def _append_rims(table, piece, ux, uy, uz, lift, later, floor_height, margin, rows, first, count):
    """Append what a cylinder that does not stand touches the floor with: its round side, and corners of its rims.

    Its side is round, so that it rolls as a cylinder when it lies. Each rim is a regular polygon, so that what tumbles
    on it loses what a rimless wheel does. Of its corners those count that are beside the lowest place now and later.
    """
    ax, ay, az = xyz(table.axes, piece)
    cosine = dot(ax, ay, az, ux, uy, uz)
    px, py, pz = ux - cosine * ax, uy - cosine * ay, uz - cosine * az
    tilt = norm(px, py, pz)
    v = table.pieces[piece, 1]
    radius = table.vertices[v, 3]
    inset = min(_INSET * radius, _MOST_INSET * table.axes[piece, 3])
    tips = max(abs(cosine), abs(dot(ax, ay, az, later[0], later[1], later[2]))) > _MIN_TILT
    for end in range(2):
        x, y, z = xyz(table.vertices, v + end)
        # The axis of a rim points out of the cylinder.
        sign = 2.0 * end - 1.0
        low = dot(ux, uy, uz, x, y, z) + lift - radius * tilt
        if abs(cosine) < LYING and low - sign * inset * cosine < margin and count < rows.shape[0]:
            k = sign * inset
            write_part(
                rows, count, 0, CIRCLE, x - k * ax, y - k * ay, z - k * az, sign * ax, sign * ay, sign * az, radius
            )
            write_part(rows, count, 8, PLANE, 0.0, 0.0, floor_height, 0.0, 0.0, 1.0, 0.0)
            count += 1
        if tips and low < margin:
            up = (ux, uy, uz, lift)
            count = _append_corners(table, piece, end, up, up, floor_height, margin, rows, first, count)
            count = _append_corners(table, piece, end, up, later, floor_height, margin, rows, first, count)
    return count


@internal_kernel
def _append_corners(table, piece, end, up, then, floor_height, margin, rows, first, count):
    """Append the two corners of a rim beside its lowest place where `then` is up, unless they are there already."""
    ex, ey, ez, fx, fy, fz = rim_axes(table, piece)
    toward_e, toward_f = dot(ex, ey, ez, then[0], then[1], then[2]), dot(fx, fy, fz, then[0], then[1], then[2])
    if math.hypot(toward_e, toward_f) < _MIN_TILT:
        return count
    v = table.pieces[piece, 1] + end
    cx, cy, cz = xyz(table.vertices, v)
    before = math.floor(math.atan2(-toward_f, -toward_e) * (0.5 / math.pi * RIM_CORNERS))
    for k in range(2):
        angle = (before + k) * (2.0 * math.pi / RIM_CORNERS)
        c, s = table.vertices[v, 3] * math.cos(angle), table.vertices[v, 3] * math.sin(angle)
        x, y, z = cx + c * ex + s * fx, cy + c * ey + s * fy, cz + c * ez + s * fz
        if dot(up[0], up[1], up[2], x, y, z) + up[3] >= margin or count == rows.shape[0]:
            continue
        known = False
        for row in range(first, count):
            known = known or (
                rows[row, 0] == POINT and norm(rows[row, 1] - x, rows[row, 2] - y, rows[row, 3] - z) < _SAME_PLACE
            )
        if not known:
            write_part(rows, count, 0, POINT, x, y, z, -1.0, 0.0, 0.0, 0.0)
            write_part(rows, count, 8, PLANE, 0.0, 0.0, floor_height, 0.0, 0.0, 1.0, 0.0)
            count += 1
    return count
