# SPDX-License-Identifier: MIT
"""Clipping of points and segments to the area over a face of a hull (numba)."""

import math

from pinwm_drake.geometry.vectors import PARALLEL_SINE, cross, dot, height, line_parameters, norm, xyz
from pinwm_drake.jit import internal_kernel

# A point this little [m] outside a side of a face counts as over the face.
ON_FACE = 1.0e-8
# A segment along a side of a face may lie this fraction of its length outside of it and counts as over the
# face.
ALONG_SIDE = 1.0e-4
# The nearest points of a crossing may lie this little [m] beyond the ends of their edges.
BEYOND_END = 1.0e-6
# Segments that meet at less than this angle [rad] run along each other, and a segment along a face that it
# meets at less than this: they touch in a manifold of contacts.
MANIFOLD_ANGLE = 0.1
# Cosine above which the normal of a candidate is the one that was looked for: within 4.5e-5 rad.
SAME_NORMAL = 1.0 - 1.0e-9
# In penetration a candidate deeper than the least translation by more than this [m] is not a contact.
DEEPER = 1.0e-7


@internal_kernel
def outside_face(table, face, x, y, z):
    """Distance [m] by which a point lies outside the worst side of a face, measured in the face's plane."""
    worst = -math.inf
    for k in range(table.faces[face], table.faces[face + 1]):
        worst = max(worst, height(table.sides, k, x, y, z))
    return worst


@internal_kernel
def clip_to_face(table, face, px, py, pz, ux, uy, uz, length):
    """Return the part of the segment p + t u, 0 <= t <= length, over a face (all in the frame of the face's body).

    Returns:
        Its ends t (m; the first beyond the second where nothing lies over the face) and at each the side of
        the face that is crossed there, or -1 at an end of the segment.
    """
    enter, leave, enter_side, leave_side = 0.0, length, -1, -1
    for k in range(table.faces[face], table.faces[face + 1]):
        sx, sy, sz = xyz(table.sides, k)
        start = height(table.sides, k, px, py, pz)
        slope = dot(sx, sy, sz, ux, uy, uz)
        end = start + slope * length
        if abs(slope) < PARALLEL_SINE:
            if min(start, end) > ALONG_SIDE * length:
                return length, 0.0, -1, -1
        elif start > ON_FACE or end > ON_FACE:
            if start > ON_FACE and end > ON_FACE:
                return length, 0.0, -1, -1
            t = -start / slope
            if start > ON_FACE:
                if t > enter:
                    enter, enter_side = t, k
            elif t < leave:
                leave, leave_side = t, k
    return enter, leave, enter_side, leave_side


@internal_kernel
def gap_over_side(table, face, side, px, py, pz, ux, uy, uz, length, kx, ky, kz):
    """Gap [m] of the segment p + t u and the edge at a side of a face, as lines, counted upwards.

    Returns:
        The gap (infinite where they are parallel, do not run along the face, or are nearest beyond their ends),
        and the cosine between its normal, out of the face, and the unit vector k.
    """
    nx, ny, nz = xyz(table.planes, face)
    edge = table.corners[side, 1]
    qx, qy, qz = xyz(table.vertices, table.edges[edge, 0])
    vx, vy, vz = xyz(table.edge_lines, edge)
    wx, wy, wz = px - qx, py - qy, pz - qz
    cx, cy, cz = cross(ux, uy, uz, vx, vy, vz)
    size = norm(cx, cy, cz)
    upwards = dot(cx, cy, cz, nx, ny, nz)
    if size < PARALLEL_SINE or abs(upwards) < math.cos(MANIFOLD_ANGLE) * size:
        return math.inf, 0.0
    s, t = line_parameters(ux, uy, uz, vx, vy, vz, wx, wy, wz)
    if min(s, t) < -BEYOND_END or s > length + BEYOND_END or t > table.edge_lines[edge, 3] + BEYOND_END:
        return math.inf, 0.0
    size = math.copysign(size, upwards)
    return dot(cx, cy, cz, wx, wy, wz) / size, dot(cx, cy, cz, kx, ky, kz) / size
