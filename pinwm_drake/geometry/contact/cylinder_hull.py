# SPDX-License-Identifier: MIT
"""Capsules and hulls against a cylinder (numba).

A search by `epa` or `gjk` gives the normal of a curved body only to the square root of its tolerance. It names the
features, though: every pair of a part of the cylinder with a vertex, edge or face near the search's result has a normal
in closed form, and the separation along a normal is a lower bound of the signed distance whatever the normal is. The
pair with the largest bound is the contact.
"""

import math

import numpy as np

from pinwm_drake.geometry.contact.cylinder_manifold import cap_on_face, segment_along_side, segment_on_cap, side_on_face
from pinwm_drake.geometry.contact.cylinder_parts import rim_line, write_cap, write_rim, write_rim_line, write_rim_place
from pinwm_drake.geometry.contact.epa import expand
from pinwm_drake.geometry.contact.face_clip import DEEPER, MANIFOLD_ANGLE, outside_face
from pinwm_drake.geometry.contact.gjk import distance
from pinwm_drake.geometry.contact.manifold import aligned_face
from pinwm_drake.geometry.contact.segments import COINCIDENT, SAME
from pinwm_drake.geometry.contact.support import separation_along, support
from pinwm_drake.geometry.pieces import HULL
from pinwm_drake.geometry.rows import write_face, write_line, write_line_pair, write_vertex
from pinwm_drake.geometry.vectors import (
    PARALLEL_SINE,
    cross,
    dot,
    inverse_pose,
    line_through,
    norm,
    radial,
    transform,
    turn,
    turn_back,
    xyz,
)
from pinwm_drake.jit import allocating_kernel, internal_kernel

# Of the searches, m. With a radius of curvature of centimetres the normal is then right to about 1e-3 rad.
_TOLERANCE = 1.0e-8
# Above this separation [m] the distance is searched, below it the separation itself.
_APART = 1.0e-6
# Pairs of features, that of the segment or hull first.
FACE_RIM, VERTEX_CAP, EDGE_SIDE, VERTEX_SIDE, VERTEX_RIM, EDGE_RIM = 0, 1, 2, 3, 4, 5
_CANDIDATES = 28


@allocating_kernel
def _cylinder_axis(table, one, two, X_21, margin):
    """Return the normal and features by which a capsule's segment or a hull `one` meets a cylinder `two`.

    Returns:
        The signed distance of the cores (m; at least the margin where that is exceeded), the unit normal from
        `two` to `one` (frame 2), the pair of features, the vertices of the edge or twice the vertex or face
        of `one`, and the end of the cylinder.
    """
    ends = np.empty((4, 2), np.int64)
    size = 3
    best, nx, ny, nz = expand(table, one, two, X_21, margin, _TOLERANCE, ends)
    if best >= margin:
        return best, nx, ny, nz, 0, 0, 0, 0
    if best > _APART:
        best, nx, ny, nz, size = distance(table, one, two, X_21, nx, ny, nz, _TOLERANCE, ends)
    ax, ay, az = nx, ny, nz
    best, pair, first, second, end = -math.inf, VERTEX_CAP, ends[0, 0], ends[0, 0], 0
    for k in range(_CANDIDATES):
        p, a, b, e, mx, my, mz = _candidate(table, one, two, X_21, k, ends, size, ax, ay, az)
        if p < 0:
            continue
        apart = separation_along(table, one, two, X_21, mx, my, mz)
        if apart > best + SAME:
            best, pair, first, second, end = apart, p, a, b, e
            nx, ny, nz = mx, my, mz
    return best, nx, ny, nz, pair, first, second, end


@internal_kernel
def _candidate(table, one, two, X_21, k, ends, size, nx, ny, nz):
    """Candidate k near the axis n: pair of features (-1: none), their indices as above, and its normal."""
    none = -1
    ux, uy, uz = xyz(table.axes, two)
    end = 1 if dot(nx, ny, nz, ux, uy, uz) > 0.0 else 0
    if k == 0:
        if table.pieces[one, 0] != HULL:
            return none, 0, 0, end, nx, ny, nz
        mx, my, mz = turn_back(X_21, -nx, -ny, -nz)
        face, _ = aligned_face(table, one, mx, my, mz)
        mx, my, mz = turn(X_21, *xyz(table.planes, face))
        return FACE_RIM, face, face, 1 if dot(mx, my, mz, ux, uy, uz) < 0.0 else 0, -mx, -my, -mz
    if k == 1:
        sign = 2.0 * end - 1.0
        mx, my, mz = turn_back(X_21, -sign * ux, -sign * uy, -sign * uz)
        _, _, _, v = support(table, one, mx, my, mz)
        return VERTEX_CAP, v, v, end, sign * ux, sign * uy, sign * uz
    cx, cy, cz = xyz(table.piece_spheres, two)
    half, radius = 0.5 * table.axes[two, 3], table.vertices[table.pieces[two, 1], 3]
    if k < 10:
        row = (k - 2) // 2
        if row >= size:
            return none, 0, 0, end, nx, ny, nz
        v = ends[row, 0]
        x, y, z = transform(X_21, *xyz(table.vertices, v))
        x, y, z = x - cx, y - cy, z - cz
        ex, ey, ez, across = radial(ux, uy, uz, x, y, z)
        if across < COINCIDENT:
            return none, 0, 0, end, nx, ny, nz
        if k % 2 == 0:
            return VERTEX_SIDE, v, v, end, ex, ey, ez
        along = dot(ux, uy, uz, x, y, z)
        over_cap, over_side = abs(along) - half, across - radius
        if over_cap < COINCIDENT or over_side < COINCIDENT:
            return none, 0, 0, end, nx, ny, nz
        end = 1 if along > 0.0 else 0
        sign = 2.0 * end - 1.0
        mx = over_side * ex + sign * over_cap * ux
        my = over_side * ey + sign * over_cap * uy
        mz = over_side * ez + sign * over_cap * uz
        length = norm(mx, my, mz)
        return VERTEX_RIM, v, v, end, mx / length, my / length, mz / length
    # Pairs of the rows of `ends` in the order 01, 02, 12, 03, 13, 23, each with side, first rim and second
    # rim.
    number, part = (k - 10) // 3, (k - 10) % 3
    row = 3 if number >= 3 else (2 if number >= 1 else 1)
    other = number - row * (row - 1) // 2
    if row >= size or ends[row, 0] == ends[other, 0]:
        return none, 0, 0, end, nx, ny, nz
    v, w = min(ends[row, 0], ends[other, 0]), max(ends[row, 0], ends[other, 0])
    px, py, pz, dx, dy, dz, _ = line_through(X_21, table.vertices, v, w)
    if part > 0:
        mx, my, mz, _, _ = rim_line(table, two, part - 1, px, py, pz, dx, dy, dz, nx, ny, nz)
        # Not a number, or a normal on which the other rim lies farther out.
        if not (2.0 * part - 3.0) * dot(mx, my, mz, ux, uy, uz) > -SAME:
            return none, 0, 0, end, nx, ny, nz
        return EDGE_RIM, v, w, part - 1, mx, my, mz
    mx, my, mz = cross(ux, uy, uz, dx, dy, dz)
    length = math.copysign(norm(mx, my, mz), dot(mx, my, mz, nx, ny, nz))
    if abs(length) < PARALLEL_SINE:
        return none, 0, 0, end, nx, ny, nz
    return EDGE_SIDE, v, w, end, mx / length, my / length, mz / length


@internal_kernel
def _write_pair(table, one, two, X_21, nx, ny, nz, pair, first, second, end, rows, count, column):
    """Write the features that `_cylinder_axis` found."""
    j = table.pieces[two, 1]
    ux, uy, uz = xyz(table.axes, two)
    qx, qy, qz = xyz(table.vertices, j)
    if pair == FACE_RIM:
        write_face(table, first, rows, count, column)
        _, _, _, across = radial(ux, uy, uz, nx, ny, nz)
        if across > PARALLEL_SINE:
            write_rim(table, two, end, rows, count, 8 - column)
        else:
            write_rim_place(table, two, end, 0, rows, count, 8 - column)
    elif pair == EDGE_SIDE:
        write_line_pair(table, first, second, j, j + 1, X_21, nx, ny, nz, rows, count, column)
    elif pair == EDGE_RIM:
        write_rim_line(table, two, end, first, second, X_21, nx, ny, nz, rows, count, 8 - column)
    else:
        write_vertex(table, first, rows, count, column)
        if pair == VERTEX_CAP:
            write_cap(table, two, end, rows, count, 8 - column)
        elif pair == VERTEX_RIM:
            write_rim(table, two, end, rows, count, 8 - column)
        else:
            x, y, z = transform(X_21, *xyz(table.vertices, first))
            t = dot(x - qx, y - qy, z - qz, ux, uy, uz)
            write_line(table, j, j + 1, t, 1.0, rows, count, 8 - column)


@internal_kernel
def collide_with_cylinder(table, one, two, X_21, column, margin, rows, count):
    """Append the contacts of a capsule or hull with a cylinder; arguments of `segments.collide_rounds`."""
    i = table.pieces[one, 1]
    radius = table.vertices[i, 3]
    if table.pieces[one, 0] == HULL:
        face, apart = _best_face(table, one, two, X_21)
        if apart >= margin:
            return count
        # Mostly the contact is on a face, and is then known without a search.
        nx, ny, nz = turn(X_21, *xyz(table.planes, face))
        more, nearest = _on_face(
            table, one, two, X_21, -nx, -ny, -nz, face, apart - DEEPER, column, margin, rows, count
        )
        if nearest <= apart + SAME and (apart >= 0.0 or _holds(table, one, two, X_21, face, apart)):
            return more
    apart, nx, ny, nz, pair, first, second, end = _cylinder_axis(table, one, two, X_21, margin + radius)
    apart -= radius
    if apart >= margin:
        return count
    least, nearest, on_face = apart - DEEPER, math.inf, False
    if table.pieces[one, 0] == HULL:
        mx, my, mz = turn_back(X_21, -nx, -ny, -nz)
        face, cosine = aligned_face(table, one, mx, my, mz)
        if pair == FACE_RIM:
            face, cosine = first, 1.0
        if cosine >= math.cos(MANIFOLD_ANGLE):
            before = count
            count, nearest = _on_face(table, one, two, X_21, nx, ny, nz, face, least, column, margin, rows, count)
            on_face = count > before
    if not on_face and pair != FACE_RIM and pair != EDGE_RIM:
        v, w = first, second
        if pair != EDGE_SIDE:
            v, w = _edge_at(table, one, two, X_21, first, pair == VERTEX_CAP)
        if v != w:
            if pair == VERTEX_CAP:
                count, nearest = segment_on_cap(
                    table, v, w, two, X_21, nx, ny, nz, end, least, column, margin, rows, count
                )
            elif _along(table, two, X_21, v, w, False) < MANIFOLD_ANGLE:
                count, nearest = segment_along_side(
                    table, v, w, two, X_21, nx, ny, nz, least, column, margin, rows, count
                )
    if apart < nearest - SAME and count < rows.shape[0]:
        _write_pair(table, one, two, X_21, nx, ny, nz, pair, first, second, end, rows, count, column)
        count += 1
    return count


@internal_kernel
def _best_face(table, one, two, X_21):
    """Return the face of a hull along whose normal a cylinder is separated most, and that separation [m]."""
    X_12 = inverse_pose(X_21)
    ux, uy, uz = turn(X_12, *xyz(table.axes, two))
    cx, cy, cz = transform(X_12, *xyz(table.piece_spheres, two))
    half, radius = 0.5 * table.axes[two, 3], table.vertices[table.pieces[two, 1], 3]
    best, apart = -1, -math.inf
    for f in range(table.pieces[one, 2], table.pieces[one + 1, 2]):
        nx, ny, nz = xyz(table.planes, f)
        along = dot(nx, ny, nz, ux, uy, uz)
        across = math.sqrt(max(1.0 - along * along, 0.0))
        d = dot(nx, ny, nz, cx, cy, cz) - table.planes[f, 3] - half * abs(along) - radius * across
        if d > apart + SAME:
            best, apart = f, d
    return best, apart


@internal_kernel
def _holds(table, one, two, X_21, face, apart):
    """Flag: the least translation out of a slight penetration is along a face's normal, for certain.

    The Minkowski difference has a facet over this face. Where the facet extends by R about the point below
    which the origin lies at depth d, no direction within 168 degrees of the normal leads out sooner if R >=
    10 d; and none of the others does if the middles of the pieces are far enough apart against the normal.
    """
    X_12 = inverse_pose(X_21)
    j = table.pieces[two, 1]
    nx, ny, nz = xyz(table.planes, face)
    ux, uy, uz = turn(X_12, *xyz(table.axes, two))
    ex, ey, ez, across = radial(ux, uy, uz, -nx, -ny, -nz)
    along = dot(nx, ny, nz, ux, uy, uz)
    # The lowest point; on a line of contact the point of it nearest to the middle of the face.
    lower = j + 1 if along < 0.0 else j
    x, y, z = transform(X_12, *xyz(table.vertices, lower))
    radius = table.vertices[j, 3]
    if across > 0.0:
        x, y, z = x + radius * ex, y + radius * ey, z + radius * ez
    mx, my, mz = xyz(table.piece_spheres, one)
    if abs(along) * table.axes[two, 3] < SAME:
        t = dot(mx - x, my - y, mz - z, ux, uy, uz)
        t = min(max(t, 0.0), table.axes[two, 3]) if along >= 0.0 else min(max(t, -table.axes[two, 3]), 0.0)
        x, y, z = x + t * ux, y + t * uy, z + t * uz
    if outside_face(table, face, x, y, z) > 10.0 * apart:
        return False
    cx, cy, cz = transform(X_12, *xyz(table.piece_spheres, two))
    dx, dy, dz = cx - mx, cy - my, cz - mz
    over = dot(nx, ny, nz, dx, dy, dz)
    beside = norm(dx - over * nx, dy - over * ny, dz - over * nz)
    return 0.98 * over - 0.2 * beside >= -apart


@internal_kernel
def _on_face(table, one, two, X_21, kx, ky, kz, face, least, column, margin, rows, count):
    """Append the manifold of a cylinder on a face where its side or cap is nearly parallel to it."""
    nx, ny, nz = turn(X_21, *xyz(table.planes, face))
    ux, uy, uz = xyz(table.axes, two)
    along = dot(nx, ny, nz, ux, uy, uz)
    if abs(along) < MANIFOLD_ANGLE:
        return side_on_face(table, one, two, X_21, kx, ky, kz, face, least, column, margin, rows, count)
    if abs(along) > math.cos(MANIFOLD_ANGLE):
        end = 1 if along < 0.0 else 0
        return cap_on_face(table, one, two, X_21, kx, ky, kz, face, end, least, column, margin, rows, count)
    return count, math.inf


@internal_kernel
def _along(table, two, X_21, v, w, across):
    """Sine of the angle between the edge from v to w and the axis of a cylinder, or its cosine (`across`)."""
    px, py, pz = turn(X_21, *xyz(table.vertices, v))
    dx, dy, dz = turn(X_21, *xyz(table.vertices, w))
    ux, uy, uz = xyz(table.axes, two)
    dx, dy, dz = dx - px, dy - py, dz - pz
    _, _, _, sine = radial(ux, uy, uz, dx, dy, dz)
    length = norm(dx, dy, dz)
    return abs(dot(ux, uy, uz, dx, dy, dz)) / length if across else sine / length


@internal_kernel
def _edge_at(table, one, two, X_21, v, across):
    """Edge at vertex v that runs along a cylinder, or `across` its axis, within MANIFOLD_ANGLE; else v twice."""
    if table.pieces[one, 0] != HULL:
        i = table.pieces[one, 1]
        return (i, i + 1) if _along(table, two, X_21, i, i + 1, across) < MANIFOLD_ANGLE else (v, v)
    best, w = MANIFOLD_ANGLE, v
    for e in range(table.pieces[one, 3], table.pieces[one + 1, 3]):
        a, b = table.edges[e, 0], table.edges[e, 1]
        if a == v or b == v:
            angle = _along(table, two, X_21, a, b, across)
            if angle < best - SAME:
                best, w = angle, a + b - v
    return min(v, w), max(v, w)
