# SPDX-License-Identifier: MIT
"""Distance of two disjoint pieces (numba).

Source: E. G. Gilbert, D. W. Johnson, S. S. Keerthi, "A fast procedure for computing the distance between
complex objects in three-dimensional space", IEEE J. Robotics and Automation 4(2), 1988; the nearest point of
a simplex by Voronoi regions after C. Ericson, Real-Time Collision Detection, sections 5.1.5-5.1.6.
"""

import math

import numpy as np

from pinwm_drake.geometry.contact.support import support_of_difference
from pinwm_drake.geometry.vectors import dot, norm, xyz
from pinwm_drake.jit import allocating_kernel, internal_kernel

_MAX_ITERATIONS = 64


@allocating_kernel
def distance(table, one, two, X_21, nx, ny, nz, tolerance, ends):
    """Distance of the cores of two pieces that do not touch.

    Args:
        table: PieceTable.
        one, two: The pieces.
        X_21: Pose of the body of `one` in that of `two`, twelve scalars.
        nx, ny, nz: A guess of the normal from `two` to `one`, frame 2.
        tolerance: The distance is within this of the true one, m (0: as accurate as float64 allows).
        ends: (4, 2) int64. Receives the vertices of `one` and `two` whose differences span the nearest point.

    Returns:
        The distance (m; 0 where they touch), the unit normal from `two` to `one` (frame 2), and how many rows
        of `ends` are used.
    """
    # Points of {b - a}; the one nearest to the origin is minus the shortest translation of `one` into `two`.
    simplex = np.empty((4, 3))
    weights = np.empty(4)
    best = np.empty(4)
    x, y, z, i, j = support_of_difference(table, one, two, X_21, nx, ny, nz)
    simplex[0, 0], simplex[0, 1], simplex[0, 2] = x, y, z
    ends[0, 0], ends[0, 1] = i, j
    size = 1
    for _ in range(_MAX_ITERATIONS):
        squared = x * x + y * y + z * z
        if squared < 1.0e-24:
            return 0.0, nx, ny, nz, size
        wx, wy, wz, i, j = support_of_difference(table, one, two, X_21, -x, -y, -z)
        # |v| minus the separation along v bounds the error.
        gain = squared - dot(x, y, z, wx, wy, wz)
        if gain <= tolerance * math.sqrt(squared) + 1.0e-15 * squared:
            break
        known = False
        for k in range(size):
            known = known or (simplex[k, 0] == wx and simplex[k, 1] == wy and simplex[k, 2] == wz)
        if known:
            break
        simplex[size, 0], simplex[size, 1], simplex[size, 2] = wx, wy, wz
        ends[size, 0], ends[size, 1] = i, j
        size += 1
        tx, ty, tz = _nearest(simplex, size, weights, best)
        if tx * tx + ty * ty + tz * tz >= squared:
            # No progress in float64: without the new point the simplex was as good.
            size -= 1
            break
        x, y, z = tx, ty, tz
        kept = 0
        for k in range(size):
            if weights[k] > 0.0:
                for c in range(3):
                    simplex[kept, c] = simplex[k, c]
                ends[kept, 0], ends[kept, 1] = ends[k, 0], ends[k, 1]
                kept += 1
        size = kept
    length = norm(x, y, z)
    return length, -x / length, -y / length, -z / length, size


@internal_kernel
def _nearest(simplex, size, weights, best):
    """Point of a simplex nearest to the origin; its weights come in `weights`, `best` is scratch."""
    for k in range(4):
        weights[k] = 0.0
    if size == 2:
        ax, ay, az = xyz(simplex, 0)
        dx, dy, dz = xyz(simplex, 1)
        dx, dy, dz = dx - ax, dy - ay, dz - az
        t = min(max(-dot(ax, ay, az, dx, dy, dz) / dot(dx, dy, dz, dx, dy, dz), 0.0), 1.0)
        weights[0], weights[1] = 1.0 - t, t
        return ax + t * dx, ay + t * dy, az + t * dz
    # The origin is outside: the nearest point of a tetrahedron lies on one of its faces.
    shortest = math.inf
    x, y, z = 0.0, 0.0, 0.0
    for skip in range(3 if size == 3 else 0, 4):
        i, j, k = (skip + 1) % 4, (skip + 2) % 4, (skip + 3) % 4
        a, b, c = _triangle(simplex, i, j, k)
        px = a * simplex[i, 0] + b * simplex[j, 0] + c * simplex[k, 0]
        py = a * simplex[i, 1] + b * simplex[j, 1] + c * simplex[k, 1]
        pz = a * simplex[i, 2] + b * simplex[j, 2] + c * simplex[k, 2]
        squared = px * px + py * py + pz * pz
        if squared < shortest:
            shortest = squared
            x, y, z = px, py, pz
            best[skip], best[i], best[j], best[k] = 0.0, a, b, c
    for k in range(4):
        weights[k] = best[k]
    return x, y, z


@internal_kernel
def _triangle(simplex, i, j, k):
    """Barycentric coordinates of the point of a triangle nearest to the origin."""
    ax, ay, az = xyz(simplex, i)
    bx, by, bz = xyz(simplex, j)
    cx, cy, cz = xyz(simplex, k)
    ux, uy, uz, vx, vy, vz = bx - ax, by - ay, bz - az, cx - ax, cy - ay, cz - az
    d1, d2 = -dot(ux, uy, uz, ax, ay, az), -dot(vx, vy, vz, ax, ay, az)
    if d1 <= 0.0 and d2 <= 0.0:
        return 1.0, 0.0, 0.0
    d3, d4 = -dot(ux, uy, uz, bx, by, bz), -dot(vx, vy, vz, bx, by, bz)
    if d3 >= 0.0 and d4 <= d3:
        return 0.0, 1.0, 0.0
    w = d1 * d4 - d3 * d2
    if w <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        t = d1 / (d1 - d3)
        return 1.0 - t, t, 0.0
    d5, d6 = -dot(ux, uy, uz, cx, cy, cz), -dot(vx, vy, vz, cx, cy, cz)
    if d6 >= 0.0 and d5 <= d6:
        return 0.0, 0.0, 1.0
    v = d5 * d2 - d1 * d6
    if v <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        t = d2 / (d2 - d6)
        return 1.0 - t, 0.0, t
    u = d3 * d6 - d5 * d4
    if u <= 0.0 and d4 - d3 >= 0.0 and d5 - d6 >= 0.0:
        t = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        return 0.0, 1.0 - t, t
    total = u + v + w
    return u / total, v / total, w / total
