# SPDX-License-Identifier: MIT
"""The narrow phase: feature pairs of all pieces of two bodies, or of a body and the floor (numba).

It only selects features; `features` computes gap, normal and points from them in closed form.
"""

from pinwm_drake.geometry.contact.capsule_hull import collide_capsule_hull
from pinwm_drake.geometry.contact.cylinder_cylinder import collide_cylinders
from pinwm_drake.geometry.contact.cylinder_hull import collide_with_cylinder
from pinwm_drake.geometry.contact.hull_hull import collide_hulls
from pinwm_drake.geometry.contact.segments import collide_rounds
from pinwm_drake.geometry.contact.spheres import collide_sphere_cylinder, collide_sphere_hull
from pinwm_drake.geometry.floor import collide_floor
from pinwm_drake.geometry.pieces import CAPSULE, HULL, SPHERE
from pinwm_drake.geometry.vectors import inverse_pose, relative_pose, transform, xyz
from pinwm_drake.jit import internal_kernel, large_internal_kernel

__all__ = ["collide_bodies", "collide_floor"]


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
    for i in range(table.bodies[body_A, 0], table.bodies[body_A + 1, 0]):
        cx, cy, cz = transform(X_BA, *xyz(table.piece_spheres, i))
        reach = table.piece_spheres[i, 3] + margin
        if _apart(cx, cy, cz, reach, table.body_spheres, body_B):
            continue
        for j in range(table.bodies[body_B, 0], table.bodies[body_B + 1, 0]):
            if _apart(cx, cy, cz, reach, table.piece_spheres, j):
                continue
            # The less general kind comes first; `column` says to which body it belongs.
            one, two, X_21, column = i, j, X_BA, 0
            if table.pieces[i, 0] > table.pieces[j, 0]:
                one, two, X_21, column = j, i, X_AB, 8
            kind_1, kind_2 = table.pieces[one, 0], table.pieces[two, 0]
            if kind_2 <= CAPSULE:
                count = collide_rounds(table, one, two, X_21, column, margin, rows, count)
            elif kind_2 == HULL and kind_1 == SPHERE:
                count = collide_sphere_hull(table, one, two, X_21, column, margin, rows, count)
            elif kind_2 == HULL and kind_1 == CAPSULE:
                count = collide_capsule_hull(table, one, two, X_21, column, margin, rows, count)
            elif kind_2 == HULL:
                count = collide_hulls(table, one, two, X_21, column, margin, rows, count)
            elif kind_1 == SPHERE:
                count = collide_sphere_cylinder(table, one, two, X_21, column, margin, rows, count)
            elif kind_1 <= HULL:
                count = collide_with_cylinder(table, one, two, X_21, column, margin, rows, count)
            else:
                count = collide_cylinders(table, one, two, X_21, column, margin, rows, count)
    return count


@internal_kernel
def _apart(cx, cy, cz, reach, spheres, k):
    """Flag: a sphere of radius `reach` about c, in B, misses sphere k."""
    dx, dy, dz = cx - spheres[k, 0], cy - spheres[k, 1], cz - spheres[k, 2]
    reach += spheres[k, 3]
    return dx * dx + dy * dy + dz * dz > reach * reach
