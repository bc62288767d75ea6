# SPDX-License-Identifier: MIT
"""Contacts that are none: what passes beside a body within a step (numba).

A contact holds a gap along the normal of the step's start, as if the feature it belongs to had no end. What
flies over a rim would hit the plane beyond it. So the step is solved with all rows; where two bodies that were apart
push each other, and do not touch after the step, these rows are left out and the step is solved again. If they then
overlap anywhere on the way, the rows come back.

What was left out is open in the step's modes, so that the gradient is that of the contacts that acted.
"""

import math

from pinwm_drake.geometry.contact.narrowphase import collide_bodies, collide_floor
from pinwm_drake.geometry.features import contact_from_features
from pinwm_drake.geometry.vectors import norm
from pinwm_drake.jit import kernel, large_kernel, part_of_kernel
from pinwm_drake.physics.kernels.cone import OPEN
from pinwm_drake.physics.kernels.detect import place_pieces
from pinwm_drake.physics.kernels.dynamics import integrate_quaternion, rotation_from_quaternion

# Bodies that were nearer than this before the step, m, were in contact, whatever they do.
APART = 1e-4
# Bodies that are nearer than this after the step touch, m; deeper than this they overlap.
TOUCHING = 2e-5
# Way between two looks for overlap, m: what is thinner may be missed; and the most looks of a step.
STRIDE = 1e-3
MOST_LOOKS = 500
# Slack of a row that is left out, m/s.
_OPEN = 1.0


@large_kernel
def _move(model, bodies, solver, sweep, share):
    """Poses of all pieces' frames after a share of the step, by the velocities found."""
    nb, h = model.num_bodies, share * bodies.time_step[0]
    for b in range(nb + model.num_kinematic):
        V = solver.x[6 * b : 6 * b + 6] if b < nb else bodies.V[b]
        q = sweep.q[b]
        for i in range(4):
            q[i] = bodies.q[b, i]
        integrate_quaternion(q, h * V[0], h * V[1], h * V[2])
        rotation_from_quaternion(q, sweep.R[b])
        for i in range(3):
            sweep.p[b, i] = bodies.p[b, i] + h * V[3 + i]
    place_pieces(model, bodies.center, sweep.R, sweep.p, sweep.p)


@large_kernel
def _nearest(model, bodies, sweep, A, B):
    """Smallest gap of two bodies at the poses of the sweep, m; TOUCHING where they are farther apart."""
    R, p, rows, point = sweep.R, sweep.p, sweep.rows, sweep.point
    offset = bodies.offset[model.pair_index[A, B]]
    near = TOUCHING + max(offset, 0.0)
    if model.num_bodies + 1 == B:
        found = collide_floor(model.table, A, bodies.spread[A], R[A], p[A], model.floor_height, near, rows, 0)
    else:
        found = collide_bodies(model.table, A, R[A], p[A], B, R[B], p[B], near, rows, 0)
    least = TOUCHING
    for c in range(found):
        gap = contact_from_features(rows[c], R[A], p[A], R[B], p[B], point[0], point[1], point[2])
        least = min(least, gap - offset)
    return least


@kernel
def gap_after(model, bodies, solver, sweep):
    """Smallest gap of all pairs after the step, by the velocities found, m; TOUCHING where nothing is nearer."""
    _move(model, bodies, solver, sweep, 1.0)
    least = TOUCHING
    for A in range(model.num_bodies):
        for B in range(A + 1, model.num_bodies + 2):
            if model.pair_index[A, B] >= 0:
                least = min(least, _nearest(model, bodies, sweep, A, B))
    return least


@part_of_kernel
def leave_out_ghosts(model, bodies, contacts, solver, sweep):
    """Leaves out the rows of bodies that were apart, push each other, and do not touch afterwards.

    Returns:
        Number of rows that are left out; they are marked in sweep.out.
    """
    number, moved = 0, False
    for c in range(contacts.number[0]):
        sweep.out[c] = 0
    for c in range(contacts.number[0]):
        A, B = contacts.body[c, 0], contacts.body[c, 1]
        # The floor has no rim.
        if model.num_bodies + 1 == B or solver.mode[c] == OPEN or contacts.gap[c] < APART:
            continue
        if not moved:
            _move(model, bodies, solver, sweep, 1.0)
            moved = True
        if _nearest(model, bodies, sweep, A, B) >= TOUCHING:
            sweep.out[c] = 1
            number += 1
    if number > 0:
        switch_off(contacts, sweep)
    return number


@kernel
def switch_off(contacts, sweep):
    """Make the rows that are left out stay open whatever happens."""
    for c in range(contacts.number[0]):
        if sweep.out[c] == 0:
            continue
        for i in range(2):
            for j in range(3):
                for k in range(6):
                    contacts.J[c, i, j, k] = 0.0
        contacts.mu[c] = 0.0
        contacts.bias[c, 0], contacts.bias[c, 1], contacts.bias[c, 2] = _OPEN, 0.0, 0.0


@part_of_kernel
def take_back_hits(model, bodies, contacts, solver, sweep):
    """Unmarks the rows of bodies that overlap on the way; returns how many, whose rows are to be built anew."""
    number = 0
    looks = min(math.ceil(bodies.time_step[0] * _fastest(model, bodies, solver) / STRIDE), MOST_LOOKS)
    for look in range(1, looks + 1):
        _move(model, bodies, solver, sweep, look / looks)
        for c in range(contacts.number[0]):
            A, B = contacts.body[c, 0], contacts.body[c, 1]
            if sweep.out[c] != 0 and _nearest(model, bodies, sweep, A, B) < -TOUCHING:
                sweep.out[c] = 0
                number += 1
    return number


@kernel
def _fastest(model, bodies, solver):
    """Bound on the speed of two bodies against each other, m/s."""
    nb, fastest = model.num_bodies, 0.0
    for b in range(nb + model.num_kinematic):
        V = solver.x[6 * b : 6 * b + 6] if b < nb else bodies.V[b]
        fastest = max(fastest, norm(V[3], V[4], V[5]) + model.radius[b] * norm(V[0], V[1], V[2]))
    return 2.0 * fastest
