# SPDX-License-Identifier: MIT
"""Contact manifolds of a cylinder: with faces of hulls, with segments, and with another cylinder (numba).

All functions append pairs with a gap from `least` up to the margin [m], and return the rows used and the smallest gap
among the pairs with the unit normal k or n (m; infinite without any). The cylinder is `two`; k points from it to `one`,
in its frame.
"""

import math

import numpy as np

from pinwm_drake.geometry.contact.cylinder_parts import (
    rim_line_gap,
    rim_place,
    write_cap,
    write_crossing,
    write_rim,
    write_rim_line,
    write_rim_place,
)
from pinwm_drake.geometry.contact.face_clip import (
    ALONG_SIDE,
    BEYOND_END,
    MANIFOLD_ANGLE,
    ON_FACE,
    SAME_NORMAL,
    clip_to_face,
    gap_over_side,
    outside_face,
)
from pinwm_drake.geometry.contact.manifold import (
    MAX_CANDIDATES,
    MAX_KEPT,
    add_candidate,
    nearest_along_normal,
    reduce_candidates,
)
from pinwm_drake.geometry.features import POINT
from pinwm_drake.geometry.pieces import RIM_POINTS
from pinwm_drake.geometry.rows import write_face, write_line, write_line_pair, write_part, write_vertex
from pinwm_drake.geometry.vectors import (
    dot,
    height,
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

# Kinds of candidates of a cap on a face: a vertex on the cap, a fixed point of the rim on the face, the
# lowest point of the rim on the face, an edge across the rim.
_VERTEX, _PLACE, _LOWEST, _CROSSING = 0, 1, 2, 3
# Below this sine of the tilt the lowest point of a rim is ill-conditioned and its fixed points serve.
_MIN_TILT = 1.0e-4


@internal_kernel
def side_on_face(table, one, two, X_21, kx, ky, kz, face, least, column, margin, rows, count):
    """Return the side of a cylinder along a face of a hull: both ends of its line of contact over the face."""
    X_12 = inverse_pose(X_21)
    j = table.pieces[two, 1]
    length, radius = table.axes[two, 3], table.vertices[j, 3]
    nx, ny, nz = xyz(table.planes, face)
    ux, uy, uz = turn(X_12, *xyz(table.axes, two))
    cx, cy, cz = transform(X_12, *xyz(table.vertices, j))
    ex, ey, ez, _ = radial(ux, uy, uz, -nx, -ny, -nz)
    qx, qy, qz = cx + radius * ex, cy + radius * ey, cz + radius * ez
    enter, leave, enter_side, leave_side = clip_to_face(table, face, qx, qy, qz, ux, uy, uz, length)
    kx, ky, kz = turn(X_12, -kx, -ky, -kz)
    nearest = math.inf
    for end in range(2):
        t, side = (enter, enter_side) if end == 0 else (leave, leave_side)
        if leave < enter or (end == 1 and leave - enter < ALONG_SIDE * length):
            break
        if side < 0:
            gap = height(table.planes, face, qx + t * ux, qy + t * uy, qz + t * uz)
            cosine = dot(nx, ny, nz, kx, ky, kz)
        else:
            gap, cosine = gap_over_side(table, face, side, cx, cy, cz, ux, uy, uz, length, kx, ky, kz)
            gap -= radius
        if least <= gap < margin and count < rows.shape[0]:
            if cosine > SAME_NORMAL:
                nearest = min(nearest, gap)
            if side < 0:
                write_face(table, face, rows, count, column)
                write_rim(table, two, end, rows, count, 8 - column)
            else:
                edge = table.corners[side, 1]
                start, stop = table.edges[edge, 0], table.edges[edge, 1]
                mx, my, mz = turn(X_21, -nx, -ny, -nz)
                write_line_pair(table, start, stop, j, j + 1, X_21, mx, my, mz, rows, count, column)
            count += 1
    return count, nearest


@allocating_kernel
def cap_on_face(table, one, two, X_21, kx, ky, kz, face, end, least, column, margin, rows, count):
    """Return a cap on a face of a hull: corners of the overlap of polygon and disc, at most four."""
    X_12 = inverse_pose(X_21)
    j = table.pieces[two, 1]
    radius = table.vertices[j, 3]
    sign = 2.0 * end - 1.0
    ux, uy, uz = xyz(table.axes, two)
    ux, uy, uz = sign * ux, sign * uy, sign * uz
    cx, cy, cz = xyz(table.vertices, j + end)
    fx, fy, fz = xyz(table.planes, face)
    mx, my, mz = turn(X_21, -fx, -fy, -fz)
    places = np.empty((MAX_CANDIDATES, 5))
    features = np.empty((MAX_CANDIDATES, 3), np.int64)
    found = 0
    on_cap, on_face = dot(ux, uy, uz, kx, ky, kz), dot(mx, my, mz, kx, ky, kz)
    for v in range(table.pieces[one, 1], table.pieces[one + 1, 1]):
        x, y, z = transform(X_21, *xyz(table.vertices, v))
        gap = dot(ux, uy, uz, x - cx, y - cy, z - cz)
        _, _, _, across = radial(ux, uy, uz, x - cx, y - cy, z - cz)
        if least <= gap < margin and across <= radius + ON_FACE:
            kind = _VERTEX
            found = add_candidate(x, y, z, gap, on_cap, kind, v, v, places, features, found)
    for k in range(RIM_POINTS + 1):
        kind = _PLACE
        if k < RIM_POINTS:
            x, y, z = rim_place(table, two, end, k)
        else:
            ex, ey, ez, tilt = radial(ux, uy, uz, mx, my, mz)
            if tilt < _MIN_TILT:
                continue
            kind = _LOWEST
            x, y, z = cx + radius * ex, cy + radius * ey, cz + radius * ez
        px, py, pz = transform(X_12, x, y, z)
        gap = height(table.planes, face, px, py, pz)
        if least <= gap < margin and outside_face(table, face, px, py, pz) <= ON_FACE:
            found = add_candidate(x, y, z, gap, on_face, kind, k, k, places, features, found)
    for k in range(table.faces[face], table.faces[face + 1]):
        edge = table.corners[k, 1]
        px, py, pz = transform(X_21, *xyz(table.vertices, table.edges[edge, 0]))
        dx, dy, dz = turn(X_21, *xyz(table.edge_lines, edge))
        for t in through_disc(px - cx, py - cy, pz - cz, dx, dy, dz, ux, uy, uz, radius):
            if t < 0.0 or t > table.edge_lines[edge, 3]:
                continue
            x, y, z = px + t * dx, py + t * dy, pz + t * dz
            gap = dot(ux, uy, uz, x - cx, y - cy, z - cz)
            if least <= gap < margin:
                kind = _CROSSING
                found = add_candidate(x, y, z, gap, on_cap, kind, edge, edge, places, features, found)
    nearest = nearest_along_normal(places, found)
    if found > MAX_KEPT:
        # Directions fixed in the cylinder, at an odd angle to the points on its rim.
        px, py, pz = rim_place(table, two, end, 0)
        ex, ey, ez, _ = radial(ux, uy, uz, px - cx, py - cy, pz - cz)
        found = reduce_candidates(ex, ey, ez, ux, uy, uz, places, features, found)
    for k in range(found):
        if count >= rows.shape[0]:
            break
        kind, index = features[k, 0], features[k, 1]
        if kind == _VERTEX:
            write_vertex(table, index, rows, count, column)
            write_cap(table, two, end, rows, count, 8 - column)
        elif kind == _CROSSING:
            px, py, pz = transform(X_21, *xyz(table.vertices, table.edges[index, 0]))
            dx, dy, dz = turn(X_21, *xyz(table.edge_lines, index))
            t = dot(places[k, 0] - px, places[k, 1] - py, places[k, 2] - pz, dx, dy, dz)
            ex, ey, ez, _ = radial(ux, uy, uz, places[k, 0] - cx, places[k, 1] - cy, places[k, 2] - cz)
            v, w = table.edges[index, 0], table.edges[index, 1]
            write_crossing(table, two, end, v, w, t, ex, ey, ez, X_21, rows, count, 8 - column)
        else:
            write_face(table, face, rows, count, column)
            if kind == _LOWEST:
                write_rim(table, two, end, rows, count, 8 - column)
            else:
                write_rim_place(table, two, end, index, rows, count, 8 - column)
        count += 1
    return count, nearest


@internal_kernel
def through_disc(px, py, pz, dx, dy, dz, ux, uy, uz, radius):
    """Places t at which the line p + t d passes in and out of a cylinder about the axis u; NaN where it does not."""
    a, b = dot(px, py, pz, ux, uy, uz), dot(dx, dy, dz, ux, uy, uz)
    px, py, pz, dx, dy, dz = px - a * ux, py - a * uy, pz - a * uz, dx - b * ux, dy - b * uy, dz - b * uz
    a, b, c = dot(dx, dy, dz, dx, dy, dz), dot(px, py, pz, dx, dy, dz), dot(px, py, pz, px, py, pz)
    root = b * b - a * (c - radius * radius)
    if root <= 0.0:
        return math.nan, math.nan
    root = math.sqrt(root)
    return (-b - root) / a, (-b + root) / a


@internal_kernel
def segment_along_side(table, i, i2, two, X_21, kx, ky, kz, least, column, margin, rows, count):
    """Return a capsule's axis or a hull's edge (vertices i, i2) along the side: its ends, and rims beside it."""
    j = table.pieces[two, 1]
    radius, round_radius = table.vertices[j, 3], table.vertices[i, 3]
    ux, uy, uz = xyz(table.axes, two)
    px, py, pz, dx, dy, dz, length = line_through(X_21, table.vertices, i, i2)
    qx, qy, qz = xyz(table.vertices, j)
    nearest = math.inf
    for k in range(2):
        x, y, z = px + k * length * dx - qx, py + k * length * dy - qy, pz + k * length * dz - qz
        t = dot(x, y, z, ux, uy, uz)
        ex, ey, ez, across = radial(ux, uy, uz, x, y, z)
        gap = across - radius - round_radius
        if min(t, table.axes[two, 3] - t) >= -BEYOND_END and least <= gap < margin and count < rows.shape[0]:
            write_vertex(table, i2 if k == 1 else i, rows, count, column)
            write_line(table, j, j + 1, t, 1.0, rows, count, 8 - column)
            if dot(ex, ey, ez, kx, ky, kz) > SAME_NORMAL:
                nearest = min(nearest, gap)
            count += 1
    for end in range(2):
        x, y, z = xyz(table.vertices, j + end)
        t = dot(x - px, y - py, z - pz, dx, dy, dz)
        nx, ny, nz = px + t * dx - x, py + t * dy - y, pz + t * dz - z
        size = norm(nx, ny, nz)
        # A rim beside an end of the segment has come with that end.
        if size == 0.0 or t < 0.0 or t > length:
            continue
        nx, ny, nz = nx / size, ny / size, nz / size
        mx, my, mz, gap = rim_line_gap(table, two, end, px, py, pz, dx, dy, dz, length, -BEYOND_END, nx, ny, nz)
        gap -= round_radius
        if least <= gap < margin and count < rows.shape[0]:
            write_rim_line(table, two, end, i, i2, X_21, mx, my, mz, rows, count, 8 - column)
            if dot(mx, my, mz, kx, ky, kz) > SAME_NORMAL:
                nearest = min(nearest, gap)
            count += 1
    return count, nearest


@internal_kernel
def segment_on_cap(table, i, i2, two, X_21, kx, ky, kz, end, least, column, margin, rows, count):
    """Return a capsule's axis or a hull's edge (vertices i, i2) on a cap: both ends of its part over the cap."""
    c = table.pieces[two, 1] + end
    sign = 2.0 * end - 1.0
    radius, round_radius = table.vertices[c, 3], table.vertices[i, 3]
    ux, uy, uz = xyz(table.axes, two)
    ux, uy, uz = sign * ux, sign * uy, sign * uz
    cx, cy, cz = xyz(table.vertices, c)
    px, py, pz, dx, dy, dz, length = line_through(X_21, table.vertices, i, i2)
    enter, leave = through_disc(px - cx, py - cy, pz - cz, dx, dy, dz, ux, uy, uz, radius)
    nearest = math.inf
    if not (leave > 0.0 and enter < length):
        return count, nearest
    for k in range(2):
        t = max(enter, 0.0) if k == 0 else min(leave, length)
        gap = dot(ux, uy, uz, px + t * dx - cx, py + t * dy - cy, pz + t * dz - cz) - round_radius
        if least <= gap < margin and count < rows.shape[0]:
            if dot(ux, uy, uz, kx, ky, kz) > SAME_NORMAL:
                nearest = min(nearest, gap)
            if 0.0 < t < length:
                ex, ey, ez, _ = radial(ux, uy, uz, px + t * dx - cx, py + t * dy - cy, pz + t * dz - cz)
                write_crossing(table, two, end, i, i2, t, ex, ey, ez, X_21, rows, count, 8 - column)
            else:
                write_vertex(table, i2 if t > 0.0 else i, rows, count, column)
                write_cap(table, two, end, rows, count, 8 - column)
            count += 1
    return count, nearest


@internal_kernel
def collect_cylinder_manifold(table, one, two, X_21, X_12, nx, ny, nz, least, column, margin, rows, count):
    """Append the manifold of two cylinders whose normal (from `two` to `one`, frame 2) is n."""
    ux, uy, uz = turn(X_21, *xyz(table.axes, one))
    vx, vy, vz = xyz(table.axes, two)
    along_1, along_2 = dot(nx, ny, nz, ux, uy, uz), dot(nx, ny, nz, vx, vy, vz)
    parallel = math.cos(MANIFOLD_ANGLE)
    nearest = math.inf
    if abs(along_1) < MANIFOLD_ANGLE and abs(along_2) < MANIFOLD_ANGLE:
        if abs(dot(ux, uy, uz, vx, vy, vz)) < parallel:
            return count, nearest
        mx, my, mz = turn_back(X_21, -nx, -ny, -nz)
        for side in range(2):
            if side == 0:
                count, low = _rims_along(
                    table, one, two, X_12, mx, my, mz, BEYOND_END, least, column, margin, rows, count
                )
            else:
                count, low = _rims_along(
                    table, two, one, X_21, nx, ny, nz, -BEYOND_END, least, 8 - column, margin, rows, count
                )
            nearest = min(nearest, low)
    elif abs(along_1) > parallel and abs(along_2) > parallel:
        end_1, end_2 = 0 if along_1 > 0.0 else 1, 1 if along_2 > 0.0 else 0
        return _cap_on_cap(
            table, one, two, X_21, X_12, along_1, along_2, end_1, end_2, least, column, margin, rows, count
        )
    elif abs(along_1) < MANIFOLD_ANGLE and abs(along_2) > parallel:
        end = 1 if along_2 > 0.0 else 0
        return _side_on_cap(table, one, two, X_21, X_12, abs(along_2), end, least, column, margin, rows, count)
    elif abs(along_2) < MANIFOLD_ANGLE and abs(along_1) > parallel:
        end = 0 if along_1 > 0.0 else 1
        return _side_on_cap(table, two, one, X_12, X_21, abs(along_1), end, least, 8 - column, margin, rows, count)
    return count, nearest


@internal_kernel
def _rims_along(table, one, two, X_12, nx, ny, nz, beyond, least, column, margin, rows, count):
    """Return the rims of `one` beside the axis of `two`, up to `beyond` [m] past its ends; n points out of `one`."""
    j = table.pieces[two, 1]
    px, py, pz = transform(X_12, *xyz(table.vertices, j))
    dx, dy, dz = turn(X_12, *xyz(table.axes, two))
    nearest = math.inf
    for end in range(2):
        mx, my, mz, gap = rim_line_gap(table, one, end, px, py, pz, dx, dy, dz, table.axes[two, 3], beyond, nx, ny, nz)
        gap -= table.vertices[j, 3]
        if least <= gap < margin and count < rows.shape[0]:
            write_rim_line(table, one, end, j, j + 1, X_12, mx, my, mz, rows, count, column)
            if dot(mx, my, mz, nx, ny, nz) > SAME_NORMAL:
                nearest = min(nearest, gap)
            count += 1
    return count, nearest


@internal_kernel
def _side_on_cap(table, one, two, X_21, X_12, cosine, end, least, column, margin, rows, count):
    """Return the side of `one` on a cap of `two`: both ends of that part of its line of contact over the cap."""
    i, c = table.pieces[one, 1], table.pieces[two, 1] + end
    length, radius = table.axes[one, 3], table.vertices[i, 3]
    sign = 2.0 * end - 1.0
    nx, ny, nz = xyz(table.axes, two)
    nx, ny, nz = sign * nx, sign * ny, sign * nz
    cx, cy, cz = xyz(table.vertices, c)
    px, py, pz = transform(X_21, *xyz(table.vertices, i))
    ux, uy, uz = turn(X_21, *xyz(table.axes, one))
    ex, ey, ez, _ = radial(ux, uy, uz, -nx, -ny, -nz)
    qx, qy, qz = px + radius * ex, py + radius * ey, pz + radius * ez
    enter, leave = through_disc(qx - cx, qy - cy, qz - cz, ux, uy, uz, nx, ny, nz, table.vertices[c, 3])
    nearest = math.inf
    if not (leave > 0.0 and enter < length):
        return count, nearest
    for k in range(2):
        t = enter if k == 0 else leave
        inside = t < ON_FACE if k == 0 else t > length - ON_FACE
        if inside:
            t = k * length
        gap = dot(nx, ny, nz, qx + t * ux - cx, qy + t * uy - cy, qz + t * uz - cz)
        if least <= gap < margin and count < rows.shape[0]:
            if cosine > SAME_NORMAL:
                nearest = min(nearest, gap)
            if inside:
                write_rim(table, one, k, rows, count, column)
            else:
                x, y, z = transform(X_12, qx + t * ux, qy + t * uy, qz + t * uz)
                write_part(rows, count, column, POINT, x, y, z, 0.0, 0.0, 0.0, 0.0)
            write_cap(table, two, end, rows, count, 8 - column)
            count += 1
    return count, nearest


@allocating_kernel
def _cap_on_cap(table, one, two, X_21, X_12, along_1, along_2, end_1, end_2, least, column, margin, rows, count):
    """Cap on cap: the points fixed on either rim that lie over the other cap, and the lowest one of `one`."""
    c, d = table.pieces[one, 1] + end_1, table.pieces[two, 1] + end_2
    ux, uy, uz = xyz(table.axes, one)
    vx, vy, vz = xyz(table.axes, two)
    sign_1, sign_2 = 2.0 * end_1 - 1.0, 2.0 * end_2 - 1.0
    cx, cy, cz = xyz(table.vertices, c)
    dx, dy, dz = xyz(table.vertices, d)
    places = np.empty((MAX_CANDIDATES, 5))
    features = np.empty((MAX_CANDIDATES, 3), np.int64)
    found = 0
    for k in range(2 * RIM_POINTS):
        kind = k // RIM_POINTS
        cosine = abs(along_2) if kind == 0 else abs(along_1)
        if kind == 0:
            x, y, z = transform(X_21, *rim_place(table, one, end_1, k))
            gap = sign_2 * dot(vx, vy, vz, x - dx, y - dy, z - dz)
            _, _, _, across = radial(vx, vy, vz, x - dx, y - dy, z - dz)
            beside = across - table.vertices[d, 3]
        else:
            x, y, z = rim_place(table, two, end_2, k - RIM_POINTS)
            px, py, pz = transform(X_12, x, y, z)
            gap = sign_1 * dot(ux, uy, uz, px - cx, py - cy, pz - cz)
            _, _, _, across = radial(ux, uy, uz, px - cx, py - cy, pz - cz)
            beside = across - table.vertices[c, 3]
        if beside <= ON_FACE and least <= gap < margin:
            found = add_candidate(x, y, z, gap, cosine, kind, k, k, places, features, found)
    nearest = nearest_along_normal(places, found)
    if found > MAX_KEPT:
        px, py, pz = rim_place(table, two, end_2, 0)
        ex, ey, ez, _ = radial(vx, vy, vz, px - dx, py - dy, pz - dz)
        found = reduce_candidates(ex, ey, ez, vx, vy, vz, places, features, found)
    for k in range(found):
        if count >= rows.shape[0]:
            break
        if features[k, 0] == 0:
            write_rim_place(table, one, end_1, features[k, 1], rows, count, column)
            write_cap(table, two, end_2, rows, count, 8 - column)
        else:
            write_cap(table, one, end_1, rows, count, column)
            write_rim_place(table, two, end_2, features[k, 1] - RIM_POINTS, rows, count, 8 - column)
        count += 1
    return count, nearest
