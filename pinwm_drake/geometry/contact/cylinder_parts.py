# SPDX-License-Identifier: MIT
"""Parts of a cylinder: caps, rims and the points fixed on them (numba)."""

import math

from pinwm_drake.geometry.contact.face_clip import MANIFOLD_ANGLE
from pinwm_drake.geometry.features import CIRCLE, PLANE, POINT, nearest_circle_to_line
from pinwm_drake.geometry.pieces import RIM_POINTS
from pinwm_drake.geometry.rows import write_line, write_part
from pinwm_drake.geometry.vectors import PARALLEL_SINE, cross, dot, line_through, norm, radial, transform, xyz
from pinwm_drake.jit import internal_kernel

# A rim meets a line as a circle where the sine of the normal against the axis is more than this, so that its
# sign is beyond doubt, where the line does not run along the rim (PARALLEL_SINE), and where the line's point
# is on the side of the rim within 60 degrees, from where the nearest place is found (see `features`).
_MIN_SINE, _MIN_COSINE = 1.0e-3, 0.5
# A line that crosses a rim less steeply than this, against the radius, has no definite place on it.
CROSSING_COSINE = 0.05
# Points closer than this [m] define no direction to the accuracy of a normal.
SAME_PLACE = 1.0e-6
_COSINES = tuple(math.cos(2.0 * math.pi * k / RIM_POINTS) for k in range(RIM_POINTS))
_SINES = tuple(math.sin(2.0 * math.pi * k / RIM_POINTS) for k in range(RIM_POINTS))


@internal_kernel
def rim_axes(table, piece):
    """Return two unit vectors e and f across the axis, frame of the body, between which the places on a rim count."""
    ux, uy, uz = xyz(table.axes, piece)
    ax, ay, az = abs(ux), abs(uy), abs(uz)
    # Across the axis, from the coordinate axis that is most nearly perpendicular to it.
    if ax <= ay and ax <= az:
        ex, ey, ez = 1.0 - ux * ux, -ux * uy, -ux * uz
    elif ay <= az:
        ex, ey, ez = -uy * ux, 1.0 - uy * uy, -uy * uz
    else:
        ex, ey, ez = -uz * ux, -uz * uy, 1.0 - uz * uz
    size = norm(ex, ey, ez)
    ex, ey, ez = ex / size, ey / size, ez / size
    return ex, ey, ez, *cross(ux, uy, uz, ex, ey, ez)


@internal_kernel
def rim_place(table, piece, end, k):
    """Return the point number k fixed on a rim (`pieces.rim_points`), m, frame of the body; `end` is 0 or 1."""
    v = table.pieces[piece, 1] + end
    cx, cy, cz = xyz(table.vertices, v)
    ex, ey, ez, fx, fy, fz = rim_axes(table, piece)
    c, s = table.vertices[v, 3] * _COSINES[k], table.vertices[v, 3] * _SINES[k]
    return cx + c * ex + s * fx, cy + c * ey + s * fy, cz + c * ez + s * fz


@internal_kernel
def write_rim_place(table, piece, end, k, rows, count, column):
    """Write a point fixed on a rim."""
    x, y, z = rim_place(table, piece, end, k)
    write_part(rows, count, column, POINT, x, y, z, 0.0, 0.0, 0.0, 0.0)


@internal_kernel
def write_cap(table, piece, end, rows, count, column):
    """Write the plane of a cap."""
    x, y, z = xyz(table.vertices, table.pieces[piece, 1] + end)
    ux, uy, uz = xyz(table.axes, piece)
    sign = 2.0 * end - 1.0
    write_part(rows, count, column, PLANE, x, y, z, sign * ux, sign * uy, sign * uz, 0.0)


@internal_kernel
def write_rim(table, piece, end, rows, count, column):
    """Write a rim; its axis points out of the cylinder."""
    v = table.pieces[piece, 1] + end
    x, y, z = xyz(table.vertices, v)
    ux, uy, uz = xyz(table.axes, piece)
    sign = 2.0 * end - 1.0
    write_part(rows, count, column, CIRCLE, x, y, z, sign * ux, sign * uy, sign * uz, table.vertices[v, 3])


@internal_kernel
def rim_line(table, piece, end, px, py, pz, dx, dy, dz, nx, ny, nz):
    """Return the normal of a rim and a line p + t d near the normal n out of the cylinder (frame of its body).

    Returns:
        The unit normal (NaN where it is not defined), the distance of the line along it (m), and the place t
        there.
    """
    rx, ry, rz = xyz(table.vertices, table.pieces[piece, 1] + end)
    ux, uy, uz = xyz(table.axes, piece)
    radius = table.vertices[table.pieces[piece, 1], 3]
    ex, ey, ez, _ = radial(ux, uy, uz, nx, ny, nz)
    t = dot(rx + radius * ex - px, ry + radius * ey - py, rz + radius * ez - pz, dx, dy, dz)
    start = (px + t * dx, py + t * dy, pz + t * dz)
    ex, ey, ez = nearest_circle_to_line((rx, ry, rz), (ux, uy, uz), radius, start, (dx, dy, dz))
    tx, ty, tz = cross(ux, uy, uz, ex, ey, ez)
    mx, my, mz = cross(tx, ty, tz, dx, dy, dz)
    wx, wy, wz = px - rx - radius * ex, py - ry - radius * ey, pz - rz - radius * ez
    t = -dot(wx, wy, wz, dx, dy, dz)
    if norm(mx, my, mz) < PARALLEL_SINE:
        # The tangent runs along the line: the difference of the nearest points is the normal, while there is
        # one.
        mx, my, mz = wx + t * dx, wy + t * dy, wz + t * dz
        if norm(mx, my, mz) < SAME_PLACE:
            mx, my, mz, _ = radial(dx, dy, dz, nx, ny, nz)
    size = math.copysign(norm(mx, my, mz), dot(mx, my, mz, nx, ny, nz))
    if size == 0.0:
        return math.nan, math.nan, math.nan, math.inf, t
    mx, my, mz = mx / size, my / size, mz / size
    return mx, my, mz, dot(mx, my, mz, wx, wy, wz), t


@internal_kernel
def rim_line_gap(table, piece, end, px, py, pz, dx, dy, dz, length, beyond, nx, ny, nz):
    """Gap between a rim and a segment p + t d, 0 <= t <= length, along a normal near n out of the cylinder.

    Returns:
        The unit normal, and the gap (m; infinite where the normal is not near n, or the place is more than
        `beyond` [m] past an end).
    """
    mx, my, mz, gap, t = rim_line(table, piece, end, px, py, pz, dx, dy, dz, nx, ny, nz)
    near = dot(mx, my, mz, nx, ny, nz) > math.cos(MANIFOLD_ANGLE)
    if not near or min(t, length - t) < -beyond:
        return nx, ny, nz, math.inf
    return mx, my, mz, gap


@internal_kernel
def write_segment_place(table, v, w, t, rows, count, column):
    """Write the place t [m] on the line from vertex v to vertex w as a point, with its piece's radius."""
    x, y, z = xyz(table.vertices, v)
    dx, dy, dz = xyz(table.vertices, w)
    dx, dy, dz = dx - x, dy - y, dz - z
    t /= norm(dx, dy, dz)
    x, y, z = x + t * dx, y + t * dy, z + t * dz
    write_part(rows, count, column, POINT, x, y, z, 0.0, 0.0, 0.0, table.vertices[v, 3])


@internal_kernel
def write_crossing(table, piece, end, v, w, t, ex, ey, ez, X_CL, rows, count, column):
    """Write the place where a line over a cap crosses its rim.

    Where the line runs along the rim there is no definite place, and the line's point is written against the cap.

    Args:
        table, piece, end, v, w, X_CL, rows, count, column: as for `write_rim_line`.
        t: Place on the line, m from v.
        ex, ey, ez: Radial unit vector to that place, frame C.
    """
    px, py, pz = transform(X_CL, *xyz(table.vertices, v))
    dx, dy, dz = transform(X_CL, *xyz(table.vertices, w))
    dx, dy, dz = dx - px, dy - py, dz - pz
    write_cap(table, piece, end, rows, count, column)
    if abs(dot(ex, ey, ez, dx, dy, dz)) > CROSSING_COSINE * norm(dx, dy, dz):
        rows[count, column + 7] = table.vertices[table.pieces[piece, 1] + end, 3]
        write_line(table, v, w, t, 1.0, rows, count, 8 - column)
    else:
        write_segment_place(table, v, w, t, rows, count, 8 - column)


@internal_kernel
def write_rim_line(table, piece, end, v, w, X_CL, nx, ny, nz, rows, count, column):
    """Write a rim against the line from vertex v to vertex w of another body.

    Where the normal is along the axis, the line is written over the cap; where circle and line are ill-conditioned
    otherwise, its point against the plane across the normal.

    Args:
        table: PieceTable.
        piece: The cylinder.
        end: End of the cylinder that has the rim, 0 or 1.
        v, w: Vertices of the line.
        X_CL: Pose of the line's body in the cylinder's body C, twelve scalars.
        nx, ny, nz: Unit normal out of the cylinder, frame C.
        rows, count: Table of feature rows, and the row to write.
        column: Column of the cylinder's part in the row, 0 or 8.
    """
    c = table.pieces[piece, 1] + end
    rx, ry, rz = xyz(table.vertices, c)
    ux, uy, uz = xyz(table.axes, piece)
    ex, ey, ez, sine = radial(ux, uy, uz, nx, ny, nz)
    radius = table.vertices[c, 3]
    qx, qy, qz = rx + radius * ex, ry + radius * ey, rz + radius * ez
    px, py, pz, dx, dy, dz, _ = line_through(X_CL, table.vertices, v, w)
    t = dot(qx - px, qy - py, qz - pz, dx, dy, dz)
    fx, fy, fz, _ = radial(ux, uy, uz, px + t * dx - rx, py + t * dy - ry, pz + t * dz - rz)
    tx, ty, tz = cross(ux, uy, uz, ex, ey, ez)
    crossing = norm(*cross(tx, ty, tz, dx, dy, dz))
    near = dot(ex, ey, ez, fx, fy, fz) > _MIN_COSINE
    if sine > _MIN_SINE and crossing > PARALLEL_SINE and near:
        write_rim(table, piece, end, rows, count, column)
        write_line(table, v, w, t, 1.0, rows, count, 8 - column)
    elif near and not sine > _MIN_SINE:
        write_crossing(table, piece, end, v, w, t, fx, fy, fz, X_CL, rows, count, column)
    else:
        write_part(rows, count, column, PLANE, qx, qy, qz, nx, ny, nz, 0.0)
        write_segment_place(table, v, w, t, rows, count, 8 - column)
