# SPDX-License-Identifier: MIT
"""Two convex hulls against each other (numba).

The axis of largest separation is found first; it is a lower bound of the signed distance, and the signed
distance itself in penetration. Then the manifold about that axis is collected. Where a pair of it attains the
bound, it is the nearest pair; where none does, the hulls are apart and meet with a vertex or at the ends of
edges, and the nearest pair is found by `gjk` and appended too.
"""

import numpy as np

from pinwm_drake.geometry.contact.epa import expand
from pinwm_drake.geometry.contact.face_clip import DEEPER
from pinwm_drake.geometry.contact.gjk import distance
from pinwm_drake.geometry.contact.manifold import aligned_face, collect_manifold
from pinwm_drake.geometry.contact.segments import COINCIDENT, append_segments
from pinwm_drake.geometry.contact.separating_axis import EDGES, FACE_OF_ONE, FACE_OF_TWO, separating_axis
from pinwm_drake.geometry.contact.support import support
from pinwm_drake.geometry.rows import write_face, write_line_pair, write_vertex
from pinwm_drake.geometry.vectors import turn_back
from pinwm_drake.jit import allocating_kernel, internal_kernel

# Hulls whose pairs of edges, and of faces and vertices, are more than this take `epa` instead of all axes. At
# the limit both take about 5 us.
_MAX_PAIRS = 1500
# Of the face that `epa` returns, and of a gap that attains its separation [m].
_TOLERANCE = 1.0e-10


@allocating_kernel
def collide_hulls(table, one, two, X_21, column, margin, rows, count):
    """Append the contacts of two hulls; arguments as for `segments.collide_rounds`."""
    ends = np.empty((4, 2), np.int64)
    kind, first, second = EDGES, -1, -1
    large = _pairs(table, one, two) > _MAX_PAIRS
    if large:
        apart, nx, ny, nz = expand(table, one, two, X_21, margin, _TOLERANCE, ends)
    else:
        apart, nx, ny, nz, kind, first, second = separating_axis(table, one, two, X_21, margin)
    if apart >= margin:
        return count
    count, nearest = collect_manifold(table, one, two, X_21, nx, ny, nz, apart - DEEPER, column, margin, rows, count)
    if nearest <= apart + _TOLERANCE or count >= rows.shape[0]:
        return count
    if apart >= COINCIDENT:
        apart, nx, ny, nz, size = distance(table, one, two, X_21, nx, ny, nz, 0.0, ends)
        if apart >= margin or apart >= nearest - _TOLERANCE:
            return count
        return _append_nearest(table, one, two, X_21, nx, ny, nz, ends, size, nearest, column, margin, rows, count)
    if large:
        kind, first, second = _features_of_axis(table, one, two, X_21, nx, ny, nz, ends)
    if kind == FACE_OF_TWO:
        write_vertex(table, second, rows, count, column)
        write_face(table, first, rows, count, 8 - column)
    elif kind == FACE_OF_ONE:
        write_face(table, first, rows, count, column)
        write_vertex(table, second, rows, count, 8 - column)
    else:
        if large:
            i, i2, _ = _corners(ends, 3, 0)
            j, j2, _ = _corners(ends, 3, 1)
        else:
            i, i2 = table.edges[first, 0], table.edges[first, 1]
            j, j2 = table.edges[second, 0], table.edges[second, 1]
        write_line_pair(table, i, i2, j, j2, X_21, nx, ny, nz, rows, count, column)
    return count + 1


@internal_kernel
def _pairs(table, one, two):
    vertices_1 = table.pieces[one + 1, 1] - table.pieces[one, 1]
    vertices_2 = table.pieces[two + 1, 1] - table.pieces[two, 1]
    faces_1 = table.pieces[one + 1, 2] - table.pieces[one, 2]
    faces_2 = table.pieces[two + 1, 2] - table.pieces[two, 2]
    edges_1 = table.pieces[one + 1, 3] - table.pieces[one, 3]
    edges_2 = table.pieces[two + 1, 3] - table.pieces[two, 3]
    return edges_1 * edges_2 + faces_1 * vertices_2 + faces_2 * vertices_1


@internal_kernel
def _features_of_axis(table, one, two, X_21, nx, ny, nz, ends):
    """Kind and features of an axis from `epa` as `separating_axis` gives them; for two edges they are -1."""
    i, i2, more_1 = _corners(ends, 3, 0)
    j, j2, more_2 = _corners(ends, 3, 1)
    face_2, cosine_2 = aligned_face(table, two, nx, ny, nz)
    mx, my, mz = turn_back(X_21, -nx, -ny, -nz)
    face_1, cosine_1 = aligned_face(table, one, mx, my, mz)
    # Behind a facet of the difference is a face and a vertex, or two edges; or, where an edge or face lies
    # along a face, more vertices of both.
    if i != i2 and j != j2 and not more_1 and not more_2:
        return EDGES, -1, -1
    if i == i2 or (j != j2 and cosine_2 >= cosine_1):
        _, _, _, v = support(table, one, mx, my, mz)
        return FACE_OF_TWO, face_2, v
    _, _, _, v = support(table, two, nx, ny, nz)
    return FACE_OF_ONE, face_1, v


@internal_kernel
def _append_nearest(table, one, two, X_21, nx, ny, nz, ends, size, known, column, margin, rows, count):
    """Append the pair of features that the vertices in `ends` span; `known` as for `append_segments`."""
    i, i2, face_of_one = _corners(ends, size, 0)
    j, j2, face_of_two = _corners(ends, size, 1)
    if face_of_two:
        face, _ = aligned_face(table, two, nx, ny, nz)
        write_vertex(table, i, rows, count, column)
        write_face(table, face, rows, count, 8 - column)
        return count + 1
    if face_of_one:
        mx, my, mz = turn_back(X_21, -nx, -ny, -nz)
        face, _ = aligned_face(table, one, mx, my, mz)
        write_face(table, face, rows, count, column)
        write_vertex(table, j, rows, count, 8 - column)
        return count + 1
    return append_segments(table, i, i2, j, j2, X_21, nx, ny, nz, known, column, margin, rows, count)


@internal_kernel
def _corners(ends, size, side):
    """Return the first two different vertices in a column of `ends` (or one twice), and whether there are more."""
    a = ends[0, side]
    b, more = a, False
    for k in range(1, size):
        v = ends[k, side]
        if v != a and v != b:
            more = b != a
            b = v if b == a else b
    # In the order of the hull, not of the search.
    return min(a, b), max(a, b), more
