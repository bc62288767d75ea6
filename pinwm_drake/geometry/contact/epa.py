# SPDX-License-Identifier: MIT
"""Signed distance and normal of two pieces by growing a polytope in their Minkowski difference (numba).

Source: G. van den Bergen, "Proximity queries and penetration depth computation on 3D game objects", GDC 2001.
Unlike there the polytope starts from any tetrahedron inside the difference, not from one that contains the
origin: the face with the least signed offset is expanded, so that the method runs through touching, where the
search for an enclosing tetrahedron is ill-conditioned.
"""

import math

import numpy as np

from pinwm_drake.geometry.contact.support import support_of_difference
from pinwm_drake.geometry.vectors import cross, dot, norm, transform, xyz
from pinwm_drake.jit import allocating_kernel, internal_kernel

_MAX_POINTS = 128
_MAX_FACES = 2 * _MAX_POINTS
# Heights over a face below this [m] are rounding.
_FLAT = 1.0e-13


@allocating_kernel
def expand(table, one, two, X_21, margin, tolerance, ends):
    """Largest separation of two pieces over the faces of the grown polytope.

    Args:
        table: PieceTable.
        one, two: The pieces; their cores must not both be points or segments.
        X_21: Pose of the body of `one` in that of `two`, twelve scalars.
        margin: The search ends where some axis separates the cores by this, m.
        tolerance: A face is final where the difference reaches no more than this beyond it, m.
        ends: (4, 2) int64. Receives in three rows the vertices of `one` and `two` behind the final face.

    Returns:
        The separation (m; within the tolerance of the signed distance when negative, else a lower bound of
        it) and the unit axis from `two` to `one` (frame 2).
    """
    points = np.empty((_MAX_POINTS, 3))
    sources = np.empty((_MAX_POINTS, 2), np.int64)
    corners = np.empty((_MAX_FACES, 3), np.int64)
    planes = np.empty((_MAX_FACES, 4))
    horizon = np.empty((_MAX_FACES, 2), np.int64)

    best, bx, by, bz = _first_tetrahedron(table, one, two, X_21, points, sources, corners, planes)
    number, faces = 4, 4
    while best < margin:
        face, offset = -1, math.inf
        for f in range(faces):
            if planes[f, 3] < offset - _FLAT:
                face, offset = f, planes[f, 3]
        nx, ny, nz = xyz(planes, face)
        wx, wy, wz, i, j = support_of_difference(table, one, two, X_21, nx, ny, nz)
        reach = dot(nx, ny, nz, wx, wy, wz)
        if reach - offset <= tolerance or number == _MAX_POINTS or faces > _MAX_FACES - 32:
            for k in range(3):
                ends[k, 0], ends[k, 1] = sources[corners[face, k], 0], sources[corners[face, k], 1]
            return -reach, nx, ny, nz
        if -reach > best:
            best, bx, by, bz = -reach, nx, ny, nz
        points[number, 0], points[number, 1], points[number, 2] = wx, wy, wz
        sources[number, 0], sources[number, 1] = i, j
        faces = _grow(points, number, corners, planes, horizon, faces)
        number += 1
    return best, bx, by, bz


@internal_kernel
def _first_tetrahedron(table, one, two, X_21, points, sources, corners, planes):
    """Return a tetrahedron in the difference, turned to the origin; returns the first separation and its axis."""
    cx, cy, cz = transform(X_21, *xyz(table.piece_spheres, one))
    dx, dy, dz = xyz(table.piece_spheres, two)
    dx, dy, dz = cx - dx, cy - dy, cz - dz
    size = norm(dx, dy, dz)
    if size > 1.0e-12:
        dx, dy, dz = dx / size, dy / size, dz / size
    else:
        dx, dy, dz = 1.0, 0.0, 0.0
    nx, ny, nz = dx, dy, dz
    for k in range(4):
        # Both ways along the direction; the point farther from what there is already is taken.
        px, py, pz, i, j = support_of_difference(table, one, two, X_21, dx, dy, dz)
        if k == 0:
            separation = -dot(px, py, pz, dx, dy, dz)
        else:
            qx, qy, qz, m, n = support_of_difference(table, one, two, X_21, -dx, -dy, -dz)
            ox, oy, oz = xyz(points, 0)
            level = dot(ox, oy, oz, dx, dy, dz)
            if k == 1 or level - dot(qx, qy, qz, dx, dy, dz) > dot(px, py, pz, dx, dy, dz) - level + _FLAT:
                px, py, pz, i, j = qx, qy, qz, m, n
        points[k, 0], points[k, 1], points[k, 2] = px, py, pz
        sources[k, 0], sources[k, 1] = i, j
        if k == 1:
            # Across the first edge, towards the origin.
            ox, oy, oz = xyz(points, 0)
            ex, ey, ez = px - ox, py - oy, pz - oz
            t = dot(ox, oy, oz, ex, ey, ez) / dot(ex, ey, ez, ex, ey, ez)
            dx, dy, dz = t * ex - ox, t * ey - oy, t * ez - oz
            if norm(dx, dy, dz) < 1.0e-9:
                dx, dy, dz = cross(ex, ey, ez, 1.0, 0.0, 0.0)
                if norm(dx, dy, dz) < 0.1 * norm(ex, ey, ez):
                    dx, dy, dz = cross(ex, ey, ez, 0.0, 1.0, 0.0)
        elif k == 2:
            ox, oy, oz = xyz(points, 0)
            ex, ey, ez = xyz(points, 1)
            dx, dy, dz = cross(ex - ox, ey - oy, ez - oz, px - ox, py - oy, pz - oz)
        size = norm(dx, dy, dz)
        dx, dy, dz = dx / size, dy / size, dz / size
    for f in range(4):
        corners[f, 0], corners[f, 1], corners[f, 2] = (f + 1) % 4, (f + 2) % 4, (f + 3) % 4
        _set_plane(points, corners, planes, f)
        x, y, z = xyz(points, f)
        fx, fy, fz = xyz(planes, f)
        if dot(fx, fy, fz, x, y, z) > planes[f, 3]:
            corners[f, 1], corners[f, 2] = corners[f, 2], corners[f, 1]
            _set_plane(points, corners, planes, f)
    return separation, nx, ny, nz


@internal_kernel
def _set_plane(points, corners, planes, face):
    """Compute the plane of a face; one without area gets an infinite offset and is never chosen."""
    ax, ay, az = xyz(points, corners[face, 0])
    bx, by, bz = xyz(points, corners[face, 1])
    cx, cy, cz = xyz(points, corners[face, 2])
    nx, ny, nz = cross(bx - ax, by - ay, bz - az, cx - ax, cy - ay, cz - az)
    size = norm(nx, ny, nz)
    if size < 1.0e-16:
        planes[face, 0], planes[face, 1], planes[face, 2], planes[face, 3] = 0.0, 0.0, 0.0, math.inf
        return
    nx, ny, nz = nx / size, ny / size, nz / size
    planes[face, 0], planes[face, 1], planes[face, 2] = nx, ny, nz
    planes[face, 3] = (dot(nx, ny, nz, ax, ay, az) + dot(nx, ny, nz, bx, by, bz) + dot(nx, ny, nz, cx, cy, cz)) / 3.0


@internal_kernel
def _grow(points, new, corners, planes, horizon, faces):
    """Replace the faces that a new point sees by a cone over their outline; return the number of faces."""
    wx, wy, wz = xyz(points, new)
    kept, length = 0, 0
    for f in range(faces):
        if planes[f, 0] * wx + planes[f, 1] * wy + planes[f, 2] * wz - planes[f, 3] <= _FLAT:
            for c in range(3):
                corners[kept, c] = corners[f, c]
            for c in range(4):
                planes[kept, c] = planes[f, c]
            kept += 1
            continue
        for c in range(3):
            start, end = corners[f, c], corners[f, (c + 1) % 3]
            # An edge between two seen faces comes once in each direction.
            twin = -1
            for h in range(length):
                if horizon[h, 0] == end and horizon[h, 1] == start:
                    twin = h
            if twin >= 0:
                length -= 1
                horizon[twin, 0], horizon[twin, 1] = horizon[length, 0], horizon[length, 1]
            elif length < _MAX_FACES:
                horizon[length, 0], horizon[length, 1] = start, end
                length += 1
    # Flat faces can make the outline longer than a convex polytope's is; what has no room is left out, and ends it.
    for h in range(min(length, _MAX_FACES - kept)):
        corners[kept, 0], corners[kept, 1], corners[kept, 2] = horizon[h, 0], horizon[h, 1], new
        _set_plane(points, corners, planes, kept)
        kept += 1
    return kept
