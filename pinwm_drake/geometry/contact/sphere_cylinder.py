"""A sphere against a cylinder, in closed form (numba)."""

from pinwm_drake.geometry.contact.cylinder_parts import radial, write_cap, write_rim
from pinwm_drake.geometry.contact.segments import COINCIDENT, SAME, write_coincident
from pinwm_drake.geometry.rows import dot, transform, write_line, write_vertex, xyz
from pinwm_drake.jit import internal_kernel


@internal_kernel
def collide_sphere_cylinder(table, ball, drum, X_21, column, margin, rows, count):
    """Appends the contact of a sphere with a cylinder; arguments as for `segments.collide_rounds`."""
    v, j = table.pieces[ball, 1], table.pieces[drum, 1]
    ux, uy, uz = xyz(table.axes, drum)
    half, radius = 0.5 * table.axes[drum, 3], table.vertices[j, 3]
    mx, my, mz = xyz(table.piece_spheres, drum)
    x, y, z = transform(X_21, *xyz(table.vertices, v))
    x, y, z = x - mx, y - my, z - mz
    along = dot(ux, uy, uz, x, y, z)
    _, _, _, across = radial(ux, uy, uz, x, y, z)
    end = 1 if along > 0.0 else 0
    over_cap, over_side = abs(along) - half, across - radius
    gap = max(over_cap, over_side)
    if over_cap > 0.0 and over_side > 0.0:
        gap = (over_cap * over_cap + over_side * over_side) ** 0.5
    if gap - table.vertices[v, 3] >= margin or count >= rows.shape[0]:
        return count
    if over_side > COINCIDENT and over_cap > COINCIDENT:
        write_vertex(table, v, rows, count, column)
        write_rim(table, drum, end, rows, count, 8 - column)
    elif over_cap >= over_side - SAME:
        write_vertex(table, v, rows, count, column)
        write_cap(table, drum, end, rows, count, 8 - column)
    elif across > COINCIDENT:
        write_vertex(table, v, rows, count, column)
        write_line(table, j, j + 1, along + half, 1.0, rows, count, 8 - column)
    else:
        write_coincident(table, v, j, ux, uy, uz, rows, count, column)
    return count + 1
