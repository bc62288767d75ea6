# SPDX-License-Identifier: MIT
"""The axis of largest separation of two convex hulls, by trying all face normals and edge pairs (numba).

Exact through touching into penetration, where iterative methods lose their direction; the cost is the product
of the edge numbers, so that large hulls take `epa` instead.

Source: D. Gregorius, "The separating axis test between convex polyhedra", GDC 2013: of all pairs of edges
only those whose arcs on the Gauss map cross give a face of the Minkowski difference.
"""

import math

from pinwm_drake.geometry.contact.segments import SAME
from pinwm_drake.geometry.vectors import PARALLEL_SINE, cross, dot, norm, transform, turn, turn_back, xyz
from pinwm_drake.jit import internal_kernel

# Which features the axis belongs to.
FACE_OF_TWO, FACE_OF_ONE, EDGES = 0, 1, 2


@internal_kernel
def separating_axis(table, one, two, X_21, margin):
    """Largest separation of two hulls over the normals of the faces of their Minkowski difference.

    Args:
        table: PieceTable.
        one, two: The hulls.
        X_21: Pose of the body of `one` in that of `two`, twelve scalars.
        margin: The search ends where some axis separates them by this, m.

    Returns:
        The separation (m; the signed distance when negative, else a lower bound of it), the unit axis from
        `two` to `one` (frame 2), its kind, and its features: face and deepest vertex of the other hull, or
        the two edges.
    """
    best, kind, first, second = -math.inf, FACE_OF_TWO, -1, -1
    nx, ny, nz = 0.0, 0.0, 0.0
    for f in range(table.pieces[two, 2], table.pieces[two + 1, 2]):
        fx, fy, fz = xyz(table.planes, f)
        gx, gy, gz = turn_back(X_21, fx, fy, fz)
        v, low = _lowest(table, one, gx, gy, gz)
        low += fx * X_21[9] + fy * X_21[10] + fz * X_21[11] - table.planes[f, 3]
        if low > best + SAME:
            best, kind, first, second = low, FACE_OF_TWO, f, v
            nx, ny, nz = fx, fy, fz
            if best >= margin:
                return best, nx, ny, nz, kind, first, second
    for f in range(table.pieces[one, 2], table.pieces[one + 1, 2]):
        fx, fy, fz = turn(X_21, *xyz(table.planes, f))
        v, low = _lowest(table, two, fx, fy, fz)
        low -= fx * X_21[9] + fy * X_21[10] + fz * X_21[11] + table.planes[f, 3]
        if low > best + SAME:
            best, kind, first, second = low, FACE_OF_ONE, f, v
            nx, ny, nz = -fx, -fy, -fz
            if best >= margin:
                return best, nx, ny, nz, kind, first, second
    for e in range(table.pieces[one, 3], table.pieces[one + 1, 3]):
        ex, ey, ez = turn(X_21, *xyz(table.edge_lines, e))
        lx, ly, lz = turn(X_21, *xyz(table.planes, table.edges[e, 2]))
        rx, ry, rz = turn(X_21, *xyz(table.planes, table.edges[e, 3]))
        px, py, pz = transform(X_21, *xyz(table.vertices, table.edges[e, 0]))
        for g in range(table.pieces[two, 3], table.pieces[two + 1, 3]):
            # The arc (l, r) of `one` against the arc of `two`, which is mirrored in the difference.
            ax, ay, az = xyz(table.planes, table.edges[g, 2])
            bx, by, bz = xyz(table.planes, table.edges[g, 3])
            la, lb = dot(ex, ey, ez, ax, ay, az), dot(ex, ey, ez, bx, by, bz)
            if la * lb >= 0.0:
                continue
            dx, dy, dz = xyz(table.edge_lines, g)
            al, ar = dot(dx, dy, dz, lx, ly, lz), dot(dx, dy, dz, rx, ry, rz)
            if al * ar >= 0.0 or la * ar >= 0.0:
                continue
            cx, cy, cz = cross(ex, ey, ez, dx, dy, dz)
            size = norm(cx, cy, cz)
            if size < PARALLEL_SINE:
                continue
            # The normal points out of `two`, as the normals of the faces beside its edge do.
            if dot(cx, cy, cz, ax + bx, ay + by, az + bz) < 0.0:
                size = -size
            qx, qy, qz = xyz(table.vertices, table.edges[g, 0])
            apart = dot(cx, cy, cz, px - qx, py - qy, pz - qz) / size
            if apart > best + SAME:
                best, kind, first, second = apart, EDGES, e, g
                nx, ny, nz = cx / size, cy / size, cz / size
                if best >= margin:
                    return best, nx, ny, nz, kind, first, second
    return best, nx, ny, nz, kind, first, second


@internal_kernel
def _lowest(table, hull, nx, ny, nz):
    """Return the vertex of a hull that is lowest along n, and its height [m]."""
    lowest, low = -1, math.inf
    for v in range(table.pieces[hull, 1], table.pieces[hull + 1, 1]):
        along = table.vertices[v, 0] * nx + table.vertices[v, 1] * ny + table.vertices[v, 2] * nz
        if along < low:
            lowest, low = v, along
    return lowest, low
