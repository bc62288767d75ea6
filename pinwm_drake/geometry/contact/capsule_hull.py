# SPDX-License-Identifier: MIT
"""A capsule against a convex hull (numba).

A segment has few features, so all candidates are tried instead of iterating. The largest separation over the
normals of the hull's faces, and over the normals of segment and silhouette edges, is a lower bound of the
signed distance of the segment; it is the signed distance in penetration, and where a pair of features attains
it. Elsewhere the nearest pair lies on the hull's edges and is found by going through them.

Everything is computed in the frame H of the hull's body; the frame of the capsule's body is S.
"""

import math

from pinwm_drake.geometry.contact.face_clip import (
    ALONG_SIDE,
    DEEPER,
    MANIFOLD_ANGLE,
    SAME_NORMAL,
    clip_to_face,
    gap_over_side,
)
from pinwm_drake.geometry.contact.segments import COINCIDENT, SAME, append_segments, closest_on_segments
from pinwm_drake.geometry.rows import write_face, write_line_pair, write_vertex
from pinwm_drake.geometry.vectors import PARALLEL_SINE, dot, height, norm, transform, turn, xyz
from pinwm_drake.jit import internal_kernel


@internal_kernel
def collide_capsule_hull(table, stick, hull, X_HS, column, margin, rows, count):
    """Contacts of a capsule with a hull; arguments as for `collide_sphere_hull`."""
    v = table.pieces[stick, 1]
    length, radius = table.axes[stick, 3], table.vertices[v, 3]
    px, py, pz = transform(X_HS, *xyz(table.vertices, v))
    ux, uy, uz = turn(X_HS, *xyz(table.axes, stick))
    face, over = -1, -math.inf
    for f in range(table.pieces[hull, 2], table.pieces[hull + 1, 2]):
        nx, ny, nz = xyz(table.planes, f)
        h = height(table.planes, f, px, py, pz) + min(dot(nx, ny, nz, ux, uy, uz) * length, 0.0)
        if h > over + SAME:
            face, over = f, h
    if over - radius >= margin:
        return count
    edge, edge_over, nx, ny, nz = silhouette_separation(table, hull, px, py, pz, ux, uy, uz)
    if edge_over - radius >= margin:
        return count
    # A contact pair that attains the largest separation is the nearest one.
    separation = max(over, edge_over)
    if edge_over > over + SAME:
        # The normal of an edge can be nearly that of a face; then the face carries the contact.
        face = _face_along(table, edge, ux, uy, uz)
    else:
        nx, ny, nz = xyz(table.planes, face)
    nearest = math.inf
    if face >= 0:
        count, nearest = segment_on_face(
            table, stick, face, X_HS, nx, ny, nz, separation - radius - DEEPER, column, margin, rows, count
        )
        if nearest <= separation - radius + SAME:
            return count
    if separation >= COINCIDENT:
        return _append_nearest(table, stick, hull, X_HS, nearest, column, margin, rows, count)
    if count >= rows.shape[0]:
        return count
    if edge_over > over + SAME:
        # The axis has passed the edge.
        lx, ly, lz = xyz(table.planes, table.edges[edge, 2])
        rx, ry, rz = xyz(table.planes, table.edges[edge, 3])
        start, end = table.edges[edge, 0], table.edges[edge, 1]
        write_line_pair(table, v, v + 1, start, end, X_HS, lx + rx, ly + ry, lz + rz, rows, count, column)
    else:
        deeper = 1 if dot(nx, ny, nz, ux, uy, uz) * length < -SAME else 0
        write_vertex(table, v + deeper, rows, count, column)
        write_face(table, face, rows, count, 8 - column)
    return count + 1


@internal_kernel
def silhouette_separation(table, hull, px, py, pz, ux, uy, uz):
    """Return the silhouette edge whose normal separates a line (p, u) most from a hull, and how far; else -1, -inf."""
    best, over = -1, -math.inf
    bx, by, bz = 0.0, 0.0, 0.0
    for e in range(table.pieces[hull, 3], table.pieces[hull + 1, 3]):
        left, right = table.edges[e, 2], table.edges[e, 3]
        lx, ly, lz = xyz(table.planes, left)
        rx, ry, rz = xyz(table.planes, right)
        a = lx * ux + ly * uy + lz * uz
        b = rx * ux + ry * uy + rz * uz
        # An edge along the line has no normal of its own with it: its ends are tried as points instead.
        if a * b >= 0.0 or max(abs(a), abs(b)) < PARALLEL_SINE:
            continue
        a, b = abs(a), abs(b)
        nx, ny, nz = b * lx + a * rx, b * ly + a * ry, b * lz + a * rz
        x, y, z = xyz(table.vertices, table.edges[e, 0])
        size = norm(nx, ny, nz)
        d = dot(nx, ny, nz, px - x, py - y, pz - z) / size
        if d > over + SAME:
            best, over = e, d
            bx, by, bz = nx / size, ny / size, nz / size
    return best, over, bx, by, bz


@internal_kernel
def _face_along(table, edge, ux, uy, uz):
    """Return the face beside an edge to which a line is parallel within MANIFOLD_ANGLE, or -1."""
    left, right = table.edges[edge, 2], table.edges[edge, 3]
    lx, ly, lz = xyz(table.planes, left)
    rx, ry, rz = xyz(table.planes, right)
    a, b = abs(dot(lx, ly, lz, ux, uy, uz)), abs(dot(rx, ry, rz, ux, uy, uz))
    if min(a, b) > MANIFOLD_ANGLE:
        return -1
    return left if a <= b + SAME else right


@internal_kernel
def segment_on_face(table, stick, face, X_HS, kx, ky, kz, least, column, margin, rows, count):
    """Append the ends of that part of a segment which lies over a face.

    An end of the segment gives point against plane, a crossing of the face's boundary gives line against
    line.

    Returns:
        Rows used now, and the smallest gap among the candidates (m; infinite where nothing lies over the
        face).
    """
    v = table.pieces[stick, 1]
    length, radius = table.axes[stick, 3], table.vertices[v, 3]
    px, py, pz = transform(X_HS, *xyz(table.vertices, v))
    ux, uy, uz = turn(X_HS, *xyz(table.axes, stick))
    enter, leave, enter_side, leave_side = clip_to_face(table, face, px, py, pz, ux, uy, uz, length)
    if leave < enter:
        return count, math.inf
    nx, ny, nz = xyz(table.planes, face)
    nearest = math.inf
    for which in range(2):
        t, side = (enter, enter_side) if which == 0 else (leave, leave_side)
        if which == 1 and leave - enter < ALONG_SIDE * length:
            break
        x, y, z = px + t * ux, py + t * uy, pz + t * uz
        if side < 0:
            gap = height(table.planes, face, x, y, z) - radius
            if least <= gap < margin and count < rows.shape[0]:
                write_vertex(table, v + which, rows, count, column)
                write_face(table, face, rows, count, 8 - column)
                if dot(nx, ny, nz, kx, ky, kz) > SAME_NORMAL:
                    nearest = min(nearest, gap)
                count += 1
            continue
        gap, cosine = gap_over_side(table, face, side, px, py, pz, ux, uy, uz, length, kx, ky, kz)
        gap -= radius
        if least <= gap < margin and count < rows.shape[0]:
            edge = table.corners[side, 1]
            start, end = table.edges[edge, 0], table.edges[edge, 1]
            write_line_pair(table, v, v + 1, start, end, X_HS, nx, ny, nz, rows, count, column)
            if cosine > SAME_NORMAL:
                nearest = min(nearest, gap)
            count += 1
    return count, nearest


@internal_kernel
def _append_nearest(table, stick, hull, X_HS, known, column, margin, rows, count):
    """Append the nearest pair of a capsule and the edges of a hull; `known` as for `append_segments`."""
    v = table.pieces[stick, 1]
    length = table.axes[stick, 3]
    px, py, pz = transform(X_HS, *xyz(table.vertices, v))
    ux, uy, uz = turn(X_HS, *xyz(table.axes, stick))
    edge, distance = -1, math.inf
    for e in range(table.pieces[hull, 3], table.pieces[hull + 1, 3]):
        qx, qy, qz = xyz(table.vertices, table.edges[e, 0])
        ex, ey, ez = xyz(table.edge_lines, e)
        _, _, d = closest_on_segments(px, py, pz, ux, uy, uz, length, qx, qy, qz, ex, ey, ez, table.edge_lines[e, 3])
        if d < distance - SAME:
            edge, distance = e, d
    if distance < COINCIDENT:
        return count
    start, end = table.edges[edge, 0], table.edges[edge, 1]
    return append_segments(table, v, v + 1, start, end, X_HS, 0.0, 0.0, 1.0, known, column, margin, rows, count)
