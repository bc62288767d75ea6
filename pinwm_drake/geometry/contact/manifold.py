# SPDX-License-Identifier: MIT
"""Contact manifold of two convex hulls near a given normal (numba).

Candidates are the corners of the overlap of two nearly parallel faces, or of a face with a vertex or edge on
it: a vertex of either hull over the other's face gives point against plane, an edge that passes over a side
of the face line against line. At most four are kept.
"""

import math

import numpy as np

from pinwm_drake.geometry.contact.face_clip import (
    MANIFOLD_ANGLE,
    ON_FACE,
    SAME_NORMAL,
    clip_to_face,
    gap_over_side,
    outside_face,
)
from pinwm_drake.geometry.rows import write_face, write_line_pair, write_vertex
from pinwm_drake.geometry.vectors import cross, dot, inverse_pose, norm, transform, turn, turn_back, xyz
from pinwm_drake.jit import allocating_kernel, internal_kernel

VERTEX_OF_ONE, VERTEX_OF_TWO, EDGE_PAIR = 0, 1, 2
MAX_CANDIDATES = 48
MAX_KEPT = 4
# Candidates at the same place within this [m] are one.
_SAME_PLACE = 1.0e-6
# Candidates are as deep within this [m].
_SAME_DEPTH = 1.0e-7
# Of too many candidates the outermost along these directions remain, where a gap counts against a candidate
# this many times: the rim of a rounded face must not replace what touches. The directions are at an odd angle
# to the first side of the face, so that for boxes none has two equally good corners.
_GAP_WEIGHT = 5.0
_COSINES = tuple(math.cos(0.61 + 0.5 * math.pi * k) for k in range(MAX_KEPT))
_SINES = tuple(math.sin(0.61 + 0.5 * math.pi * k) for k in range(MAX_KEPT))


@internal_kernel
def aligned_face(table, hull, nx, ny, nz):
    """Return the face of a hull whose normal is nearest to n (frame of its body), and the cosine between them."""
    face, cosine = -1, -2.0
    for f in range(table.pieces[hull, 2], table.pieces[hull + 1, 2]):
        c = table.planes[f, 0] * nx + table.planes[f, 1] * ny + table.planes[f, 2] * nz
        if c > cosine + 1.0e-9:
            face, cosine = f, c
    return face, cosine


@allocating_kernel
def collect_manifold(table, one, two, X_21, nx, ny, nz, least, column, margin, rows, count):
    """Append the manifold of two hulls whose contact normal (from `two` to `one`, frame 2) is near n.

    Candidates with a gap below `least` or of `margin` and more [m] are left out.

    Returns:
        Rows used now, and the smallest gap among the candidates with that very normal (m; infinite without).
    """
    X_12 = inverse_pose(X_21)
    face_2, cosine_2 = aligned_face(table, two, nx, ny, nz)
    mx, my, mz = turn_back(X_21, -nx, -ny, -nz)
    face_1, cosine_1 = aligned_face(table, one, mx, my, mz)
    aligned = math.cos(MANIFOLD_ANGLE)
    if cosine_1 < aligned and cosine_2 < aligned:
        return count, math.inf
    # Place (frame 2), gap, cosine of the normal against n; kind and the two features, that of `one` first.
    places = np.empty((MAX_CANDIDATES, 5))
    features = np.empty((MAX_CANDIDATES, 3), np.int64)
    found = 0
    # The face of the simpler hull bounds the overlap: the other's may be one of many small ones.
    simpler = table.pieces[one + 1, 2] - table.pieces[one, 2] < table.pieces[two + 1, 2] - table.pieces[two, 2]
    bound_by_one = cosine_2 < aligned or (simpler and cosine_1 >= aligned)
    for side in range(2):
        on_two = side == 0
        face, cosine = (face_2, cosine_2) if on_two else (face_1, cosine_1)
        moving, X_FM = (one, X_21) if on_two else (two, X_12)
        if cosine >= aligned:
            found = _vertices_over(table, moving, face, X_FM, on_two, cosine, least, margin, places, features, found)
    face, moving, X_FM = (face_1, two, X_12) if bound_by_one else (face_2, one, X_21)
    kx, ky, kz = (mx, my, mz) if bound_by_one else (nx, ny, nz)
    found = _edges_over(
        table, moving, face, X_FM, X_21, kx, ky, kz, not bound_by_one, least, margin, places, features, found
    )
    nearest = nearest_along_normal(places, found)
    if found > MAX_KEPT:
        if cosine_2 >= aligned:
            ex, ey, ez = xyz(table.edge_lines, table.corners[table.faces[face_2], 1])
        else:
            ex, ey, ez = turn(X_21, *xyz(table.edge_lines, table.corners[table.faces[face_1], 1]))
        found = reduce_candidates(ex, ey, ez, nx, ny, nz, places, features, found)
    for k in range(found):
        if count >= rows.shape[0]:
            break
        first, second = features[k, 1], features[k, 2]
        if features[k, 0] == VERTEX_OF_ONE:
            write_vertex(table, first, rows, count, column)
            write_face(table, second, rows, count, 8 - column)
        elif features[k, 0] == VERTEX_OF_TWO:
            write_face(table, first, rows, count, column)
            write_vertex(table, second, rows, count, 8 - column)
        else:
            i, i2 = table.edges[first, 0], table.edges[first, 1]
            j, j2 = table.edges[second, 0], table.edges[second, 1]
            write_line_pair(table, i, i2, j, j2, X_21, nx, ny, nz, rows, count, column)
        count += 1
    return count, nearest


@internal_kernel
def add_candidate(x, y, z, gap, cosine, kind, first, second, places, features, found):
    """Add a candidate unless there is one at its place; return the number of candidates."""
    for k in range(found):
        if norm(places[k, 0] - x, places[k, 1] - y, places[k, 2] - z) < _SAME_PLACE:
            return found
    if found < places.shape[0]:
        places[found, 0], places[found, 1], places[found, 2] = x, y, z
        places[found, 3], places[found, 4] = gap, cosine
        features[found, 0], features[found, 1], features[found, 2] = kind, first, second
        found += 1
    return found


@internal_kernel
def nearest_along_normal(places, found):
    """Return the smallest gap among the candidates with the normal that was looked for; infinite without any."""
    nearest = math.inf
    for k in range(found):
        if places[k, 4] > SAME_NORMAL:
            nearest = min(nearest, places[k, 3])
    return nearest


@internal_kernel
def _vertices_over(table, moving, face, X_FM, on_two, cosine, least, margin, places, features, found):
    """Add the vertices of a hull over a face of the other; F is the frame of the face's body, 2 or 1."""
    # The plane in the frame of the moving hull: most of its vertices are far above it.
    nx, ny, nz = xyz(table.planes, face)
    mx, my, mz = turn_back(X_FM, nx, ny, nz)
    offset = table.planes[face, 3] - nx * X_FM[9] - ny * X_FM[10] - nz * X_FM[11]
    for v in range(table.pieces[moving, 1], table.pieces[moving + 1, 1]):
        gap = mx * table.vertices[v, 0] + my * table.vertices[v, 1] + mz * table.vertices[v, 2] - offset
        if not least <= gap < margin:
            continue
        x, y, z = transform(X_FM, *xyz(table.vertices, v))
        if outside_face(table, face, x, y, z) <= ON_FACE:
            kind, first, second = VERTEX_OF_ONE, v, face
            if not on_two:
                kind, first, second = VERTEX_OF_TWO, face, v
                x, y, z = xyz(table.vertices, v)
            found = add_candidate(x, y, z, gap, cosine, kind, first, second, places, features, found)
    return found


@internal_kernel
def _edges_over(table, moving, face, X_FM, X_21, kx, ky, kz, on_two, least, margin, places, features, found):
    """Add the crossings of the edges of a hull with the sides of a face of the other, whose frame is F."""
    nx, ny, nz = xyz(table.planes, face)
    mx, my, mz = turn_back(X_FM, nx, ny, nz)
    offset = table.planes[face, 3] - nx * X_FM[9] - ny * X_FM[10] - nz * X_FM[11]
    for e in range(table.pieces[moving, 3], table.pieces[moving + 1, 3]):
        v, w = table.edges[e, 0], table.edges[e, 1]
        start = mx * table.vertices[v, 0] + my * table.vertices[v, 1] + mz * table.vertices[v, 2] - offset
        stop = mx * table.vertices[w, 0] + my * table.vertices[w, 1] + mz * table.vertices[w, 2] - offset
        if min(start, stop) >= margin:
            continue
        px, py, pz = transform(X_FM, *xyz(table.vertices, v))
        ux, uy, uz = turn(X_FM, *xyz(table.edge_lines, e))
        length = table.edge_lines[e, 3]
        enter, leave, enter_side, leave_side = clip_to_face(table, face, px, py, pz, ux, uy, uz, length)
        for end in range(2):
            t, side = (enter, enter_side) if end == 0 else (leave, leave_side)
            if side < 0 or leave < enter:
                continue
            gap, cosine = gap_over_side(table, face, side, px, py, pz, ux, uy, uz, length, kx, ky, kz)
            if least <= gap < margin:
                other = table.corners[side, 1]
                x, y, z = px + t * ux, py + t * uy, pz + t * uz
                kind, first, second = EDGE_PAIR, e, other
                if not on_two:
                    first, second = other, e
                    x, y, z = transform(X_21, x, y, z)
                found = add_candidate(x, y, z, gap, cosine, kind, first, second, places, features, found)
    return found


@internal_kernel
def reduce_candidates(ex, ey, ez, nx, ny, nz, places, features, found):
    """Move the outermost candidates to the front, and the deepest in place of the nearest kept one.

    The deepest is taken among the candidates with the normal that was looked for, where there are any.

    Source: the choice of points by area in common physics engines, here by fixed directions, which is
    steadier.
    """
    fx, fy, fz = cross(nx, ny, nz, ex, ey, ez)
    deepest = 0
    for k in range(1, found):
        this, other = places[k, 4] > SAME_NORMAL, places[deepest, 4] > SAME_NORMAL
        if (this and not other) or (this == other and places[k, 3] < places[deepest, 3] - _SAME_DEPTH):
            deepest = k
    kept = 0
    for d in range(MAX_KEPT):
        best, reach = -1, -math.inf
        for k in range(found):
            x, y, z = places[k, 0], places[k, 1], places[k, 2]
            along = _COSINES[d] * dot(x, y, z, ex, ey, ez) + _SINES[d] * dot(x, y, z, fx, fy, fz)
            along -= _GAP_WEIGHT * places[k, 3]
            if along > reach + _SAME_DEPTH:
                best, reach = k, along
        if best >= kept:
            if deepest == kept:
                deepest = best
            elif deepest == best:
                deepest = kept
            _swap(places, features, kept, best)
            kept += 1
    if deepest >= kept:
        known = math.inf
        closest, distance = 0, math.inf
        x, y, z = xyz(places, deepest)
        for k in range(kept):
            if places[k, 4] > SAME_NORMAL or places[deepest, 4] <= SAME_NORMAL:
                known = min(known, places[k, 3])
            d = norm(places[k, 0] - x, places[k, 1] - y, places[k, 2] - z)
            if d < distance - _SAME_DEPTH:
                closest, distance = k, d
        if places[deepest, 3] < known - _SAME_DEPTH:
            _swap(places, features, closest, deepest)
    return kept


@internal_kernel
def _swap(places, features, i, j):
    for k in range(5):
        places[i, k], places[j, k] = places[j, k], places[i, k]
    for k in range(3):
        features[i, k], features[j, k] = features[j, k], features[i, k]
