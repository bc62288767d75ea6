# SPDX-License-Identifier: MIT
"""Support points: the farthest point of a piece, or of a difference of pieces, along a direction (numba)."""

import math

from pinwm_drake.geometry.pieces import CYLINDER
from pinwm_drake.geometry.vectors import dot, norm, transform, turn_back, xyz
from pinwm_drake.jit import internal_kernel


@internal_kernel
def support(table, piece, nx, ny, nz):
    """Farthest point of a piece's core along n; the core of a sphere or capsule is its centre or segment.

    Args:
        table: PieceTable.
        piece: Index of the piece.
        nx, ny, nz: The direction in the frame of the piece's body, of any length.

    Returns:
        The point (m, three scalars, that frame) and its vertex; for a cylinder the vertex is the cap's
        centre.
    """
    first, best, reach = table.pieces[piece, 1], -1, -math.inf
    for v in range(first, table.pieces[piece + 1, 1]):
        along = table.vertices[v, 0] * nx + table.vertices[v, 1] * ny + table.vertices[v, 2] * nz
        if along > reach:
            best, reach = v, along
    x, y, z = xyz(table.vertices, best)
    if table.pieces[piece, 0] == CYLINDER:
        ux, uy, uz = xyz(table.axes, piece)
        along = dot(ux, uy, uz, nx, ny, nz)
        ex, ey, ez = nx - along * ux, ny - along * uy, nz - along * uz
        length = norm(ex, ey, ez)
        # Along the axis what is left across it is rounding, of any direction.
        if length > 1.0e-12 * norm(nx, ny, nz):
            scale = table.vertices[best, 3] / length
            x, y, z = x + scale * ex, y + scale * ey, z + scale * ez
    return x, y, z, best


@internal_kernel
def support_of_difference(table, one, two, X_21, nx, ny, nz):
    """Farthest point of {b - a : b in `two`, a in `one`} along n, in the frame of `two`.

    With n of unit length, minus its height along n is the separation of the cores along n, n pointing from
    `two` to `one`: a lower bound of their signed distance.

    Returns:
        The point (m, three scalars), and the vertices of `one` and `two` as `support` gives them.
    """
    mx, my, mz = turn_back(X_21, -nx, -ny, -nz)
    ax, ay, az, i = support(table, one, mx, my, mz)
    ax, ay, az = transform(X_21, ax, ay, az)
    bx, by, bz, j = support(table, two, nx, ny, nz)
    return bx - ax, by - ay, bz - az, i, j


@internal_kernel
def separation_along(table, one, two, X_21, nx, ny, nz):
    """Separation of the cores along a unit vector n of frame 2 that points from `two` to `one` [m]."""
    x, y, z, _, _ = support_of_difference(table, one, two, X_21, nx, ny, nz)
    return -dot(x, y, z, nx, ny, nz)
