# SPDX-License-Identifier: MIT
"""Writing of feature rows, whose layout `features` describes (numba)."""

import math

from pinwm_drake.geometry.features import LINE, PLANE, POINT
from pinwm_drake.geometry.vectors import cross, dot, line_parameters, norm, transform, xyz
from pinwm_drake.jit import internal_kernel


@internal_kernel
def write_part(rows, count, column, kind, px, py, pz, ux, uy, uz, radius):
    """Write one body's part of a row.

    Args:
        rows: (max_contacts, 16).
        count: The row.
        column: 0 for body A, 8 for body B.
        kind: POINT, LINE, PLANE or CIRCLE.
        px, py, pz: Point of the feature, m, frame of its body.
        ux, uy, uz: Direction of the feature, unit, frame of its body; zeros for a point.
        radius: m.
    """
    rows[count, column] = kind
    rows[count, column + 1], rows[count, column + 2], rows[count, column + 3] = px, py, pz
    rows[count, column + 4], rows[count, column + 5], rows[count, column + 6] = ux, uy, uz
    rows[count, column + 7] = radius


@internal_kernel
def write_face(table, face, rows, count, column):
    """Write the plane of a face."""
    x, y, z = xyz(table.vertices, table.corners[table.faces[face], 0])
    nx, ny, nz = xyz(table.planes, face)
    write_part(rows, count, column, PLANE, x, y, z, nx, ny, nz, 0.0)


@internal_kernel
def write_vertex(table, v, rows, count, column):
    """Write a vertex of a hull, the centre of a sphere or an end of a capsule."""
    x, y, z = xyz(table.vertices, v)
    write_part(rows, count, column, POINT, x, y, z, 0.0, 0.0, 0.0, table.vertices[v, 3])


@internal_kernel
def write_line(table, v, w, t, sign, rows, count, column):
    """Write the line from vertex v to vertex w with its point at t [m] from v; `sign` orients it.

    The line is an edge of a hull, or the axis of a capsule or cylinder with its radius.
    """
    x, y, z = xyz(table.vertices, v)
    ux, uy, uz = xyz(table.vertices, w)
    ux, uy, uz = ux - x, uy - y, uz - z
    length = norm(ux, uy, uz)
    ux, uy, uz = ux / length, uy / length, uz / length
    x, y, z = x + t * ux, y + t * uy, z + t * uz
    ux, uy, uz = sign * ux, sign * uy, sign * uz
    write_part(rows, count, column, LINE, x, y, z, ux, uy, uz, table.vertices[v, 3])


@internal_kernel
def write_line_pair(table, i, i2, j, j2, X_21, nx, ny, nz, rows, count, column):
    """Write two lines at their nearest points, oriented for a normal near n.

    The normal points from the second to the first, frame 2. Lines as for `write_line`; they must not be
    parallel. The first belongs to the body of `column`.
    """
    px, py, pz = transform(X_21, *xyz(table.vertices, i))
    ux, uy, uz = transform(X_21, *xyz(table.vertices, i2))
    qx, qy, qz = xyz(table.vertices, j)
    vx, vy, vz = xyz(table.vertices, j2)
    ux, uy, uz, vx, vy, vz = ux - px, uy - py, uz - pz, vx - qx, vy - qy, vz - qz
    length, other = norm(ux, uy, uz), norm(vx, vy, vz)
    cx, cy, cz = cross(ux, uy, uz, vx, vy, vz)
    s, t = line_parameters(
        ux / length, uy / length, uz / length, vx / other, vy / other, vz / other, px - qx, py - qy, pz - qz
    )
    write_line(table, i, i2, s, math.copysign(1.0, dot(cx, cy, cz, nx, ny, nz)), rows, count, column)
    write_line(table, j, j2, t, 1.0, rows, count, 8 - column)
