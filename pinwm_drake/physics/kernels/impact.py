# SPDX-License-Identifier: MIT
"""Times of impact: what is apart at a step's start and would press at its end ends the step when it touches (numba).

A position stage holds every gap along the normal of the step's start, as if the feature that it belongs to had no end,
and for the whole step. So a contact that is apart and presses is left out, and the stage is solved for that length
after which its gap is gone. Bodies that do not touch there pass beside each other: that contact is none in this step.
"""

from pinwm_drake.geometry.contact.narrowphase import collide_bodies, collide_floor
from pinwm_drake.geometry.features import contact_from_features
from pinwm_drake.jit import kernel, large_kernel
from pinwm_drake.physics.kernels.cone import OPEN
from pinwm_drake.physics.kernels.curve import move_body
from pinwm_drake.physics.kernels.detect import AWAY, BESIDE, change_length, place_pieces, switch_off
from pinwm_drake.physics.kernels.dynamics import (
    POSITION,
    VELOCITY,
    begin_stage,
)
from pinwm_drake.physics.kernels.solve import solve_again

# Bodies that are nearer than this after a step touch, m; deeper than this they overlap.
NEAR = 2e-5
# Gap at a time of impact, m, and looks for one.
LANDED, MOST_LOOKS = 1e-14, 60
# Speeds with which a gap closes below this only graze, m/s: such a time of impact has no derivative.
GRAZES = 1e-9


@large_kernel
def move(model, bodies, solver, sweep, h):
    """Poses of all bodies after a time h, by the velocities found."""
    nb = model.num_bodies
    for b in range(nb + model.num_kinematic):
        move_body(bodies, sweep, b, solver.x[6 * b : 6 * b + 6] if b < nb else bodies.V[b], h)


@large_kernel
def _nearest(model, bodies, sweep, A, B):
    """Smallest gap of two bodies at the poses of the sweep, m; NEAR where they are farther apart."""
    R, p, rows, point = sweep.R, sweep.place, sweep.rows, sweep.point
    place_pieces(model, bodies.center, R, sweep.p, p)
    offset = bodies.offset[model.pair_index[A, B]]
    near = NEAR + max(offset, 0.0)
    if model.num_bodies + 1 == B:
        found = collide_floor(
            model.table, A, bodies.spread[A], R[A], p[A], bodies.V[A], 0.0, model.floor_height, near, rows, 0
        )
    else:
        found = collide_bodies(model.table, A, R[A], p[A], B, R[B], p[B], near, rows, 0)
    least = NEAR
    for c in range(found):
        gap = contact_from_features(rows[c], R[A], p[A], R[B], p[B], point[0], point[1], point[2])
        least = min(least, gap - offset)
    return least


@kernel
def gap_after(model, bodies, solver, sweep, above):
    """Smallest gap after the step, by the velocities found, m; NEAR where nothing is nearer.

    It is that of all pairs, or, where `above` is False, of those with the floor. Floor points that do not come and go
    are all among the contacts.
    """
    move(model, bodies, solver, sweep, bodies.time_step[0])
    least = NEAR
    for A in range(model.num_bodies):
        for B in range(A + 1 if above else model.num_bodies + 1, model.num_bodies + 2):
            on_floor = model.num_bodies + 1 == B
            if model.pair_index[A, B] >= 0 and (not on_floor or model.floor_changes[A]):
                least = min(least, _nearest(model, bodies, sweep, A, B))
    return least


@kernel
def presses_apart(contacts, mode):
    """Return whether a contact that is apart at the start presses, by the modes of the position stage."""
    presses = False
    for c in range(contacts.number[0]):
        presses = presses or (contacts.closed[c] == 0 and mode[c] != OPEN)
    return presses


@kernel
def _next(bodies, contacts, sweep):
    """Return the smallest gap of what is away, at the poses of the sweep, m, and its contact."""
    least, at = NEAR, -1
    R, p, point = sweep.R, sweep.p, sweep.point
    for c in range(contacts.number[0]):
        if sweep.out[c] != AWAY:
            continue
        A, B = contacts.body[c, 0], contacts.body[c, 1]
        gap = contact_from_features(contacts.rows[c], R[A], p[A], R[B], p[B], point[0], point[1], point[2])
        gap -= bodies.offset[contacts.pair[c]]
        if at < 0 or gap < least:
            least, at = gap, c
    return least, at


@large_kernel
def _gap_at(model, mass, inertia, bodies, contacts, system, solver, sweep, h):
    """Solve the position stage of length h without what is away; its smallest gap afterwards, contact, iterations."""
    bodies.time_step[0] = h
    begin_stage(model, mass, inertia, bodies, system, POSITION)
    change_length(model, bodies, contacts, sweep)
    for c in range(contacts.number[0]):
        # What is found is near the solution of another length.
        solver.first[c] = OPEN if sweep.out[c] != 0 else solver.mode[c]
    used = solve_again(bodies, system, contacts, solver, VELOCITY)
    move(model, bodies, solver, sweep, h)
    gap, at = _next(bodies, contacts, sweep)
    return gap, at, used


@kernel
def _share(a, b, c, at_a, at_b, at_c):
    """Return where to look next for a zero between a and b, as a share of the way from a; c was there before.

    Source: Chandrupatla, "A new hybrid quadratic/bisection algorithm for finding the zero of a nonlinear function
    without using derivatives", Adv. Eng. Softw. 28, 1997.
    """
    xi, phi = (a - b) / (c - b), (at_a - at_b) / (at_c - at_b)
    if phi * phi >= xi or (1.0 - phi) * (1.0 - phi) >= 1.0 - xi:
        return 0.5
    toward_b = at_a / (at_b - at_a) * at_c / (at_b - at_c)
    share = toward_b + (c - a) / (b - a) * at_a / (at_c - at_a) * at_b / (at_c - at_b)
    return share if 0.0 < share < 1.0 else 0.5


@large_kernel
def stop_at_touch(model, mass, inertia, bodies, contacts, system, solver, sweep):
    """Solve the position stage again, until what is apart touches first: that length is in bodies.time_step.

    The contact that touches is in solver.hit, -1 where none does in the whole step.

    Returns:
        Iterations; -1 where a number is not finite.
    """
    whole = bodies.time_step[0]
    for c in range(contacts.number[0]):
        sweep.out[c] = 0
        if contacts.closed[c] == 0:
            sweep.out[c] = AWAY
            switch_off(contacts, c)
    total = 0
    for _ in range(contacts.number[0]):
        at_high, hit, used = _gap_at(model, mass, inertia, bodies, contacts, system, solver, sweep, whole)
        if used < 0:
            return used
        total += used
        solver.hit[0] = -1
        if hit < 0 or at_high > 0.0:
            return total
        # The zero is between a, the last look, and b; first it is where the secant has it.
        a, at_a, b, at_b = whole, at_high, 0.0, contacts.gap[hit]
        share = at_a / (at_a - at_b)
        for _ in range(MOST_LOOKS):
            if abs(at_a) <= LANDED:
                break
            length = a + share * (b - a)
            landed, hit, used = _gap_at(model, mass, inertia, bodies, contacts, system, solver, sweep, length)
            if used < 0:
                return used
            total += used
            before, at_before = a, at_a
            if (landed > 0.0) != (at_a > 0.0):
                before, at_before, b, at_b = b, at_b, a, at_a
            a, at_a = length, landed
            share = _share(a, b, before, at_a, at_b, at_before)
        A, B = contacts.body[hit, 0], contacts.body[hit, 1]
        if model.num_bodies + 1 == B or _nearest(model, bodies, sweep, A, B) < NEAR:
            solver.hit[0] = hit
            return total
        sweep.out[hit] = BESIDE
    return total
