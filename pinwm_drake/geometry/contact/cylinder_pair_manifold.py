"""Contact manifolds of two cylinders: side along side, cap on cap, side on cap (numba)."""

import math

import numpy as np

from pinwm_drake.geometry.contact.cylinder_manifold import through_disc
from pinwm_drake.geometry.contact.cylinder_parts import (
    radial,
    rim_line_gap,
    rim_place,
    write_cap,
    write_rim,
    write_rim_line,
    write_rim_place,
)
from pinwm_drake.geometry.contact.face_clip import BEYOND_END, MANIFOLD_ANGLE, ON_FACE, SAME_NORMAL
from pinwm_drake.geometry.contact.manifold import (
    MAX_CANDIDATES,
    MAX_KEPT,
    add_candidate,
    nearest_along_normal,
    reduce_candidates,
)
from pinwm_drake.geometry.features import POINT
from pinwm_drake.geometry.pieces import RIM_POINTS
from pinwm_drake.geometry.rows import dot, transform, turn, turn_back, write_part, xyz
from pinwm_drake.jit import allocating_kernel, internal_kernel

_POINT = float(POINT)


@internal_kernel
def collect_cylinder_manifold(table, one, two, X_21, X_12, nx, ny, nz, least, column, margin, rows, count):
    """Appends the manifold of two cylinders whose normal (from `two` to `one`, frame 2) is n.

    Pairs with a gap below `least` or of `margin` and more [m] are left out.

    Returns:
        Rows used now, and the smallest gap among them (m; infinite without any).
    """
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
    """The rims of `one` beside the axis of `two`, up to `beyond` [m] past its ends; n points out of `one`."""
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
    """The side of `one` on a cap of `two`: both ends of that part of its line of contact over the cap."""
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
                write_part(rows, count, column, _POINT, x, y, z, 0.0, 0.0, 0.0, 0.0)
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
