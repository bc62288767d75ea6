# SPDX-License-Identifier: MIT
"""A sphere against a convex hull, and against a cylinder (numba).

Of a hull, the face with the largest plane distance is the nearest one wherever the centre lies over it, and gives the
least translation where the centre is inside. Elsewhere the nearest point is on an edge. A hull has few edges: all are
tried, which is exact and needs no iteration. A cylinder is met in closed form.
"""

import math

from pinwm_drake.geometry.contact.cylinder_parts import write_cap, write_rim
from pinwm_drake.geometry.contact.face_clip import outside_face
from pinwm_drake.geometry.contact.segments import COINCIDENT, SAME, write_coincident
from pinwm_drake.geometry.rows import write_face, write_line, write_vertex
from pinwm_drake.geometry.vectors import dot, height, radial, transform, xyz
from pinwm_drake.jit import internal_kernel


@internal_kernel
def collide_sphere_hull(table, ball, hull, X_HS, column, margin, rows, count):
    """Append the contact of a sphere with a hull; arguments as for `segments.collide_rounds`."""
    v = table.pieces[ball, 1]
    radius = table.vertices[v, 3]
    x, y, z = transform(X_HS, *xyz(table.vertices, v))
    face, over = -1, -math.inf
    for f in range(table.pieces[hull, 2], table.pieces[hull + 1, 2]):
        h = height(table.planes, f, x, y, z)
        if h > over + SAME:
            face, over = f, h
    if over - radius >= margin or count >= rows.shape[0]:
        return count
    if over < COINCIDENT or outside_face(table, face, x, y, z) <= 0.0:
        write_vertex(table, v, rows, count, column)
        write_face(table, face, rows, count, 8 - column)
        return count + 1
    nearest, edge, place = math.inf, -1, 0.0
    for e in range(table.pieces[hull, 3], table.pieces[hull + 1, 3]):
        dx, dy, dz = xyz(table.vertices, table.edges[e, 0])
        dx, dy, dz = x - dx, y - dy, z - dz
        ex, ey, ez = xyz(table.edge_lines, e)
        t = min(max(dx * ex + dy * ey + dz * ez, 0.0), table.edge_lines[e, 3])
        dx, dy, dz = dx - t * ex, dy - t * ey, dz - t * ez
        squared = dx * dx + dy * dy + dz * dz
        if squared < nearest:
            nearest, edge, place = squared, e, t
    if math.sqrt(nearest) - radius >= margin:
        return count
    write_vertex(table, v, rows, count, column)
    start, end = table.edges[edge, 0], table.edges[edge, 1]
    if place <= 0.0:
        write_vertex(table, start, rows, count, 8 - column)
    elif place >= table.edge_lines[edge, 3]:
        write_vertex(table, end, rows, count, 8 - column)
    else:
        write_line(table, start, end, place, 1.0, rows, count, 8 - column)
    return count + 1


@internal_kernel
def collide_sphere_cylinder(table, ball, drum, X_21, column, margin, rows, count):
    """Append the contact of a sphere with a cylinder; arguments as for `segments.collide_rounds`."""
    v, j = table.pieces[ball, 1], table.pieces[drum, 1]
    ux, uy, uz = xyz(table.axes, drum)
    half, radius = 0.5 * table.axes[drum, 3], table.vertices[j, 3]
    mx, my, mz = xyz(table.piece_spheres, drum)
    x, y, z = transform(X_21, *xyz(table.vertices, v))
    x, y, z = x - mx, y - my, z - mz
    along = dot(ux, uy, uz, x, y, z)
    _, _, _, across = radial(ux, uy, uz, x, y, z)
    end = 1 if along > 0.0 else 0
    over_cap, over_side = abs(along) - half, across - radius
    gap = max(over_cap, over_side)
    if over_cap > 0.0 and over_side > 0.0:
        gap = (over_cap * over_cap + over_side * over_side) ** 0.5
    if gap - table.vertices[v, 3] >= margin or count >= rows.shape[0]:
        return count
    if over_side > COINCIDENT and over_cap > COINCIDENT:
        write_vertex(table, v, rows, count, column)
        write_rim(table, drum, end, rows, count, 8 - column)
    elif over_cap >= over_side - SAME:
        write_vertex(table, v, rows, count, column)
        write_cap(table, drum, end, rows, count, 8 - column)
    elif across > COINCIDENT:
        write_vertex(table, v, rows, count, column)
        write_line(table, j, j + 1, along + half, 1.0, rows, count, 8 - column)
    else:
        write_coincident(table, v, j, ux, uy, uz, rows, count, column)
    return count + 1
