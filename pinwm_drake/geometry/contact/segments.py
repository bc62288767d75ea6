# SPDX-License-Identifier: MIT
"""Spheres and capsules against each other: points and segments with a rounding radius (numba)."""

import math

from pinwm_drake.geometry.contact.face_clip import BEYOND_END, MANIFOLD_ANGLE
from pinwm_drake.geometry.features import PLANE
from pinwm_drake.geometry.rows import write_line, write_part, write_vertex
from pinwm_drake.geometry.vectors import PARALLEL_SINE, cross, dot, norm, transform, xyz
from pinwm_drake.jit import internal_kernel

# Core points closer than this [m] define no direction; the normal is then an arbitrary one, fixed in B.
COINCIDENT = 1.0e-9
# Of two equal alternatives the first is kept unless the other is better by more than this [m].
SAME = 1.0e-12


@internal_kernel
def closest_on_segments(px, py, pz, ux, uy, uz, length, qx, qy, qz, vx, vy, vz, other):
    """Nearest points of two segments p + s u, 0 <= s <= length, and q + t v, 0 <= t <= other.

    For parallel segments (`PARALLEL_SINE`) one of the two points is an end. Source: C. Ericson, Real-Time
    Collision Detection, section 5.1.9, with unit directions.

    Returns:
        s, t (m; exactly 0 or the length at an end) and the distance (m).
    """
    wx, wy, wz = px - qx, py - qy, pz - qz
    b = dot(ux, uy, uz, vx, vy, vz)
    c = dot(ux, uy, uz, wx, wy, wz)
    f = dot(vx, vy, vz, wx, wy, wz)
    crossing = 1.0 - b * b
    s, t, distance = 0.0, 0.0, math.inf
    if crossing > PARALLEL_SINE * PARALLEL_SINE:
        s = (b * f - c) / crossing
        if 0.0 < s < length:
            t = b * s + f
            if 0.0 < t < other:
                return s, t, norm(wx + s * ux - t * vx, wy + s * uy - t * vy, wz + s * uz - t * vz)
    best_s, best_t = 0.0, 0.0
    for k in range(4):
        if k < 2:
            s = k * length
            t = min(max(b * s + f, 0.0), other)
        else:
            t = (k - 2) * other
            s = min(max(b * t - c, 0.0), length)
        gap = norm(wx + s * ux - t * vx, wy + s * uy - t * vy, wz + s * uz - t * vz)
        if gap < distance - SAME:
            best_s, best_t, distance = s, t, gap
    return best_s, best_t, distance


@internal_kernel
def collide_rounds(table, one, two, X_21, column, margin, rows, count):
    """Append the contacts of a sphere or capsule with another.

    Args:
        table: PieceTable.
        one, two: The pieces.
        X_21: Pose of the body of `one` in that of `two`, twelve scalars.
        column: 0 where `one` belongs to body A, 8 where to body B.
        margin: m.
        rows: (max_contacts, 16).
        count: Rows already used.

    Returns:
        Rows used now.
    """
    i, i2 = table.pieces[one, 1], table.pieces[one + 1, 1] - 1
    j, j2 = table.pieces[two, 1], table.pieces[two + 1, 1] - 1
    mx, my, mz = xyz(table.piece_spheres, two)
    nx, ny, nz = transform(X_21, *xyz(table.piece_spheres, one))
    nx, ny, nz = nx - mx, ny - my, nz - mz
    return append_segments(table, i, i2, j, j2, X_21, nx, ny, nz, math.inf, column, margin, rows, count)


@internal_kernel
def append_segments(table, i, i2, j, j2, X_21, nx, ny, nz, known, column, margin, rows, count):
    """Append the nearest pair of two segments, and both ends of the overlap of nearly parallel ones.

    Args:
        table: PieceTable.
        i, i2: Vertices of the first segment, the same one for a point; their radius is that of the piece.
        j, j2: Vertices of the second segment.
        X_21: Pose of the first body in the second, twelve scalars.
        nx, ny, nz: A direction from the second to the first (frame 2), for segments that cross.
        known: Gap of a pair appended before, m (infinite for none): a nearest pair no closer than that is
            left out.
        column: 0 where the first segment belongs to body A, 8 where to body B.
        margin: m.
        rows: (max_contacts, 16).
        count: Rows already used.

    Returns:
        Rows used now.
    """
    radii = table.vertices[i, 3] + table.vertices[j, 3]
    px, py, pz = transform(X_21, *xyz(table.vertices, i))
    qx, qy, qz = xyz(table.vertices, j)
    ux, uy, uz = transform(X_21, *xyz(table.vertices, i2))
    vx, vy, vz = xyz(table.vertices, j2)
    ux, uy, uz, vx, vy, vz = ux - px, uy - py, uz - pz, vx - qx, vy - qy, vz - qz
    length, other = norm(ux, uy, uz), norm(vx, vy, vz)
    if i2 != i:
        ux, uy, uz = ux / length, uy / length, uz / length
    if j2 != j:
        vx, vy, vz = vx / other, vy / other, vz / other
    s, t, distance = closest_on_segments(px, py, pz, ux, uy, uz, length, qx, qy, qz, vx, vy, vz, other)
    if distance - radii >= margin:
        return count
    cx, cy, cz = cross(ux, uy, uz, vx, vy, vz)
    if i2 != i and j2 != j and math.isinf(known) and norm(cx, cy, cz) < MANIFOLD_ANGLE:
        # The ends of either segment that lie beside the other.
        for k in range(4):
            s_k, t_k = k * length, (k - 2) * other
            if k < 2:
                t_k = dot(px + s_k * ux - qx, py + s_k * uy - qy, pz + s_k * uz - qz, vx, vy, vz)
            else:
                s_k = dot(qx + t_k * vx - px, qy + t_k * vy - py, qz + t_k * vz - pz, ux, uy, uz)
            # Ends at the same place come once: those of the first segment have precedence.
            beyond = BEYOND_END if k < 2 else -BEYOND_END
            if min(t_k, other - t_k) < -BEYOND_END or min(s_k, length - s_k) < -beyond:
                continue
            wx, wy, wz = px + s_k * ux - qx, py + s_k * uy - qy, pz + s_k * uz - qz
            gap = norm(wx - t_k * vx, wy - t_k * vy, wz - t_k * vz)
            if COINCIDENT < gap < margin + radii and count < rows.shape[0]:
                known = min(known, gap - radii)
                end_s, end_t = 0, 0
                if k < 2:
                    end_s = 2 * k - 1
                else:
                    end_t = 2 * k - 5
                _write_places(table, i, i2, j, j2, s_k, t_k, end_s, end_t, 1.0, rows, count, column)
                count += 1
    if distance - radii >= known - SAME or count >= rows.shape[0]:
        return count
    end_s = -1 if s <= 0.0 else (1 if s >= length else 0)
    end_t = -1 if t <= 0.0 else (1 if t >= other else 0)
    if distance < COINCIDENT:
        if end_s != 0 or end_t != 0:
            write_coincident(table, i2 if end_s > 0 else i, j2 if end_t > 0 else j, vx, vy, vz, rows, count, column)
            return count + 1
    else:
        nx, ny, nz = px + s * ux - qx - t * vx, py + s * uy - qy - t * vy, pz + s * uz - qz - t * vz
    sign = math.copysign(1.0, dot(cx, cy, cz, nx, ny, nz))
    _write_places(table, i, i2, j, j2, s, t, end_s, end_t, sign, rows, count, column)
    return count + 1


@internal_kernel
def _write_places(table, i, i2, j, j2, s, t, end_s, end_t, sign, rows, count, column):
    """Write a place on each of two segments; `end_s` is -1 or 1 at an end, which is copied, or 0."""
    if end_s == 0:
        write_line(table, i, i2, s, sign, rows, count, column)
    else:
        write_vertex(table, i2 if end_s > 0 else i, rows, count, column)
    if end_t == 0:
        write_line(table, j, j2, t, 1.0, rows, count, 8 - column)
    else:
        write_vertex(table, j2 if end_t > 0 else j, rows, count, 8 - column)


@internal_kernel
def write_coincident(table, i, j, vx, vy, vz, rows, count, column):
    """Write vertex i against a plane that touches the ball about vertex j, across the axis of its piece."""
    nx, ny, nz = (0.0, -vz, vy) if abs(vx) < 0.8 else (vz, 0.0, -vx)
    length = norm(nx, ny, nz)
    if length == 0.0:
        nx, ny, nz, length = 0.0, 0.0, 1.0, 1.0
    nx, ny, nz = nx / length, ny / length, nz / length
    x, y, z = xyz(table.vertices, j)
    radius = table.vertices[j, 3]
    write_vertex(table, i, rows, count, column)
    write_part(rows, count, 8 - column, PLANE, x + radius * nx, y + radius * ny, z + radius * nz, nx, ny, nz, 0.0)
