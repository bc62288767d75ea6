# SPDX-License-Identifier: MIT
"""The adjoint of a contact's geometry: to poses and shapes (numba)."""

from pinwm_drake.geometry.features import POINT, contact_adjoint, tangents_adjoint
from pinwm_drake.geometry.floor import spread_adjoint
from pinwm_drake.jit import kernel, small_kernel
from pinwm_drake.physics.kernels.triples import add, multiply_transposed


@kernel
def geometry_adjoint(model, contacts, adjoint, c, R, p, n, a, b, out, n_bar, gap_bar):
    """Adjoint of contact c's geometry at poses R, p: to those poses, in `out`, and to the shapes of its bodies.

    Args:
        n, a, b: its normal and witness points there.
        out: (N, 6), gains the gradient with respect to the poses.
        n_bar, gap_bar: gradients with respect to its normal and gap; adjoint.lever holds that of its levers.
    """
    A, B = contacts.body[c, 0], contacts.body[c, 1]
    lever, moved = adjoint.lever, adjoint.moved
    c_bar = (lever[0, 0] + lever[1, 0], lever[0, 1] + lever[1, 1], lever[0, 2] + lever[1, 2])
    add(out[A], 3, -1.0, lever[0])
    add(out[B], 3, -1.0, lever[1])
    for i in range(3):
        moved[0, i], moved[1, i] = -out[A, 3 + i], -out[B, 3 + i]
    # The features' own gap, without the pair's offset.
    phi = (a[0] - b[0]) * n[0] + (a[1] - b[1]) * n[1] + (a[2] - b[2]) * n[2]
    contact_adjoint(contacts.rows[c], R[A], p[A], R[B], p[B], n, a, b, phi, n_bar, c_bar, gap_bar, out[A], out[B])
    # A feature moves in its body as it moves with it.
    adjoint.offset[contacts.pair[c]] -= gap_bar
    for side in range(2):
        body = contacts.body[c, side]
        if contacts.dynamic[c, side] < 0:
            continue
        for i in range(3):
            moved[side, i] += out[body, 3 + i]
        g = multiply_transposed(R[body], moved[side])
        add(adjoint.center[body], 0, -1.0, g)
        if model.num_bodies + 1 == B and int(contacts.rows[c, 0]) == POINT:
            spread_adjoint(model.table, int(contacts.rows[c, 4]), g[0], g[1], g[2], adjoint.spread[body])


@small_kernel
def frame_to_pose(model, c, bodies, contacts, adjoint, gap_bar):
    """Adjoint of contact c's rows: adjoint.frame, adjoint.lever and gap_bar to poses and shapes of its bodies."""
    frame, n = adjoint.frame, contacts.frame[c, 0]
    gx, gy, gz = tangents_adjoint(n[0], n[1], n[2], contacts.frame[c, 1], frame[1], frame[2])
    n_bar = (frame[0, 0] + gx, frame[0, 1] + gy, frame[0, 2] + gz)
    a, b = contacts.witness[c, 0], contacts.witness[c, 1]
    geometry_adjoint(model, contacts, adjoint, c, bodies.R, bodies.p, n, a, b, adjoint.pose, n_bar, gap_bar)
