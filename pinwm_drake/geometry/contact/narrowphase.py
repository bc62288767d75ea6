# SPDX-License-Identifier: MIT
"""The narrow phase: feature pairs of all pieces of two bodies, or of a body and the floor (numba).

It selects features; `features` computes gap, normal and points from them in closed form. Pieces behind a shell are
looked at only where the shell is touched at an open end, or from within.
"""

import numpy as np

from pinwm_drake.geometry.contact.capsule_hull import collide_capsule_hull
from pinwm_drake.geometry.contact.cylinder_cylinder import collide_cylinders
from pinwm_drake.geometry.contact.cylinder_hull import collide_with_cylinder
from pinwm_drake.geometry.contact.hull_hull import collide_hulls
from pinwm_drake.geometry.contact.segments import collide_rounds
from pinwm_drake.geometry.contact.spheres import collide_sphere_cylinder, collide_sphere_hull
from pinwm_drake.geometry.features import contact_from_features
from pinwm_drake.geometry.floor import collide_floor
from pinwm_drake.geometry.pieces import CAPSULE, HULL, SPHERE
from pinwm_drake.geometry.vectors import dot, inverse_pose, relative_pose, rotate, transform, xyz
from pinwm_drake.jit import allocating_kernel, internal_kernel, large_internal_kernel

__all__ = ["collide_bodies", "collide_floor"]

# A shell, a cylinder with open ends, stands for the pieces behind it while it is touched from outside: with a normal
# across its axis, to this sine, or out of a closed end, and not deeper than this [m]. In a cavity a pusher of 3 mm
# radius is twice that deep in the shell, and more.
_ASIDE, _DEEPEST = 0.02, 2.0e-3


@large_internal_kernel
def collide_bodies(table, body_A, R_WA, p_WA, body_B, R_WB, p_WB, margin, rows, count):
    """Append the contacts between the pieces of two bodies.

    Args:
        table: PieceTable.
        body_A: Index of body A.
        R_WA: (3, 3), its rotation.
        p_WA: (3,), its position, m, world frame.
        body_B: Index of body B.
        R_WB: (3, 3), its rotation.
        p_WB: (3,), its position, m, world frame.
        margin: Contacts with a gap below this are appended, m.
        rows: (max_contacts, 16), receives feature rows from row `count` on.
        count: Rows already used.

    Returns:
        Rows used now; never more than there are.
    """
    X_BA = relative_pose(R_WA, p_WA, R_WB, p_WB)
    cx, cy, cz = transform(X_BA, *xyz(table.body_spheres, body_A))
    if _apart(cx, cy, cz, table.body_spheres[body_A, 3] + margin, table.body_spheres, body_B):
        return count
    X_AB = inverse_pose(X_BA)
    i = table.bodies[body_A, 0]
    while i < table.bodies[body_A + 1, 0]:
        cx, cy, cz = transform(X_BA, *xyz(table.piece_spheres, i))
        reach = table.piece_spheres[i, 3] + margin
        behind_i = table.shells[i, 0]
        j = table.bodies[body_B, 0]
        if _apart(cx, cy, cz, reach, table.body_spheres, body_B):
            j = table.bodies[body_B + 1, 0]
        while j < table.bodies[body_B + 1, 0]:
            behind_j = table.shells[j, 0]
            if not _apart(cx, cy, cz, reach, table.piece_spheres, j):
                first = count
                count = _collide_pieces(table, i, j, X_BA, X_AB, margin, rows, count)
                hide = behind_i + behind_j > 0
                if hide and not _from_outside(table, i, j, R_WA, p_WA, R_WB, p_WB, rows, first, count):
                    count = first
                    for k in range(i + min(behind_i, 1), i + behind_i + 1):
                        for m in range(j + min(behind_j, 1), j + behind_j + 1):
                            x, y, z = transform(X_BA, *xyz(table.piece_spheres, k))
                            if not _apart(x, y, z, table.piece_spheres[k, 3] + margin, table.piece_spheres, m):
                                count = _collide_pieces(table, k, m, X_BA, X_AB, margin, rows, count)
            j += 1 + behind_j
        i += 1 + behind_i
    return count


@large_internal_kernel
def _collide_pieces(table, i, j, X_BA, X_AB, margin, rows, count):
    """Append the contacts of piece i of A with piece j of B; other arguments as for `collide_bodies`."""
    # The less general kind comes first; `column` says to which body it belongs.
    one, two, X_21, column = i, j, X_BA, 0
    if table.pieces[i, 0] > table.pieces[j, 0]:
        one, two, X_21, column = j, i, X_AB, 8
    kind_1, kind_2 = table.pieces[one, 0], table.pieces[two, 0]
    if kind_2 <= CAPSULE:
        return collide_rounds(table, one, two, X_21, column, margin, rows, count)
    if kind_2 == HULL and kind_1 == SPHERE:
        return collide_sphere_hull(table, one, two, X_21, column, margin, rows, count)
    if kind_2 == HULL and kind_1 == CAPSULE:
        return collide_capsule_hull(table, one, two, X_21, column, margin, rows, count)
    if kind_2 == HULL:
        return collide_hulls(table, one, two, X_21, column, margin, rows, count)
    if kind_1 == SPHERE:
        return collide_sphere_cylinder(table, one, two, X_21, column, margin, rows, count)
    if kind_1 <= HULL:
        return collide_with_cylinder(table, one, two, X_21, column, margin, rows, count)
    return collide_cylinders(table, one, two, X_21, column, margin, rows, count)


@allocating_kernel
def _from_outside(table, i, j, R_WA, p_WA, R_WB, p_WB, rows, first, count):
    """Flag: contacts in rows [first, count) of piece i of A with j of B are on no open end, and not from within."""
    n, a, b = np.empty(3), np.empty(3), np.empty(3)
    for row in range(first, count):
        if contact_from_features(rows[row], R_WA, p_WA, R_WB, p_WB, n, a, b) < -_DEEPEST:
            return False
        if table.shells[i, 0] > 0 and _on_open_end(table, i, R_WA, -n[0], -n[1], -n[2]):
            return False
        if table.shells[j, 0] > 0 and _on_open_end(table, j, R_WB, n[0], n[1], n[2]):
            return False
    return True


@internal_kernel
def _on_open_end(table, piece, R, nx, ny, nz):
    """Flag: a normal out of a cylinder, world frame, points out of an open end of it."""
    ux, uy, uz = rotate(R, *xyz(table.axes, piece))
    along = dot(ux, uy, uz, nx, ny, nz)
    return (table.shells[piece, 2] > 0 and along > _ASIDE) or (table.shells[piece, 1] > 0 and along < -_ASIDE)


@internal_kernel
def _apart(cx, cy, cz, reach, spheres, k):
    """Flag: a sphere of radius `reach` about c, in B, misses sphere k."""
    dx, dy, dz = cx - spheres[k, 0], cy - spheres[k, 1], cz - spheres[k, 2]
    reach += spheres[k, 3]
    return dx * dx + dy * dy + dz * dz > reach * reach
