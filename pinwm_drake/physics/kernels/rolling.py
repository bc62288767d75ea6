# SPDX-License-Identifier: MIT
"""Rolling friction of rims on a floor, and its adjoint (numba).

A rim touches a floor with a patch, not with a point: what rolls on it has to lift itself over the front of the patch,
and gets nothing back behind it. Its torque is that of the weight at a lever, against the turn about horizontal axes,

    tau = -rho m g c^2 w / sqrt(w . w + w_0^2),        w: angular velocity without its part about the vertical,

with the cosine c of the tilt: a cylinder that lies touches with its side, which rolls freely. It takes energy only.

Source: rolling friction as a lever, Coulomb, "Theorie des machines simples", 1785.
"""

import math

from pinwm_drake.geometry.pieces import CYLINDER
from pinwm_drake.geometry.vectors import dot, rotate, xyz
from pinwm_drake.jit import kernel

# Lever of rolling friction, m, and the most of it as a share of a rim's radius.
LEVER, MOST_LEVER = 2e-4, 0.025
# A rim nearer than this to the floor rests on it, m.
RESTS = 1e-4
_NO_PIECE = -1


@kernel
def rolling_torque(model, mass, bodies, b):
    """Return the torque of body b about x and y per angular velocity, N m s, w_0, and the piece, -1 for none."""
    g = -model.gravity[2]
    if not model.has_rims[b] or model.pair_index[b, model.num_bodies + 1] < 0 or g <= 0.0:
        return 0.0, 1.0, _NO_PIECE
    R, table, center = bodies.R[b], model.table, bodies.center[b]
    for piece in range(table.bodies[b, 0], table.bodies[b + 1, 0]):
        if table.pieces[piece, 0] != CYLINDER:
            continue
        v = table.pieces[piece, 1]
        radius = table.vertices[v, 3]
        ax, ay, az = rotate(R, *xyz(table.axes, piece))
        x, y, z = xyz(table.vertices, v)
        lowest = dot(R[2, 0], R[2, 1], R[2, 2], x - center[0], y - center[1], z - center[2])
        lowest += min(az, 0.0) * table.axes[piece, 3] - radius * math.hypot(ax, ay)
        if bodies.p[b, 2] + lowest - model.floor_height > RESTS:
            continue
        lever = min(LEVER, MOST_LEVER * radius)
        # So that a step takes no more than all of a slow turn.
        slow = 4.0 * lever * g * model.time_step / (radius * radius)
        w = math.sqrt(bodies.V[b, 0] ** 2 + bodies.V[b, 1] ** 2 + slow * slow)
        return -lever * mass[b] * g * az * az / w, w, piece
    return 0.0, 1.0, _NO_PIECE


@kernel
def rolling_adjoint(model, mass, bodies, adjoint, mass_bar, b, x, y):
    """Adjoint of the torque, from gradients x and y of its components: to pose, mass, and V, which it returns."""
    k, w, piece = rolling_torque(model, mass, bodies, b)
    if piece < 0 or k == 0.0:
        return 0.0, 0.0
    V = bodies.V[b]
    along = V[0] * x + V[1] * y
    mass_bar[b] += k * along / mass[b]
    a = rotate(bodies.R[b], *xyz(model.table.axes, piece))
    turn = 2.0 * k * along / a[2]
    adjoint.pose[b, 0] += turn * a[1]
    adjoint.pose[b, 1] -= turn * a[0]
    return k * (x - V[0] * along / (w * w)), k * (y - V[1] * along / (w * w))
