# SPDX-License-Identifier: MIT
"""Contacts of recorded states: the narrow phase, one step laid open, and the impulses of all steps (numba)."""

import numpy as np

from pinwm_drake.jit import entry_point, kernel
from pinwm_drake.physics.kernels.cone import negative_residual
from pinwm_drake.physics.kernels.detect import select_features
from pinwm_drake.physics.kernels.dynamics import rotation_from_quaternion
from pinwm_drake.physics.kernels.rollout import drive, load, load_geometry
from pinwm_drake.physics.kernels.step import build_step, solve_step
from pinwm_drake.physics.kernels.workspace import make_workspace


@kernel
def _impulses_of_world(w, model, parameters, V_P, states, impulses, status, work):
    mass, inertia, friction, restitution = parameters[0][w], parameters[1][w], parameters[2][w], parameters[3][w]
    bodies, contacts, system, solver, sweep = work
    load_geometry(model, bodies, parameters, w)
    for t in range(V_P.shape[0]):
        load(bodies, model.num_bodies, model.num_kinematic > 0, states, t, w)
        drive(bodies, model.num_bodies, model.num_kinematic > 0, V_P, t, w)
        contacts.elastic[0] = 1.0
        build_step(model, mass, inertia, friction, restitution, bodies, contacts, system)
        if solve_step(model, friction, restitution, bodies, contacts, system, solver, sweep) < 0:
            status[w] = -t - 1
            return
        for c in range(contacts.number[0]):
            for i in range(3):
                for j in range(3):
                    impulses[t, w, contacts.pair[c], j] += solver.lam[c, i] * contacts.frame[c, i, j]


@entry_point
def contact_impulses(model, parameters, V_P, states, impulses, status, limit, first, last):
    """Solves every step of worlds first..last-1 from its recorded state, without holding Python's lock.

    Args:
        model: ModelArrays.
        parameters: as in `rollout.rollout_forward`.
        V_P: (T, W, 6), pusher velocities.
        states: q, p, V, q_P and p_P of the T frames or more at which the steps begin, as from `allocate_frames`.
        impulses: (T, W, num_pairs, 3), zeros; receives the sums over the contacts of each pair, on A, world frame, N s.
        status: (W,), receives minus the failed step's number minus one where there was no solution.
        limit: rows of the contact tables.
        first, last: range of worlds.
    """
    for w in range(first, last):
        work = make_workspace(model, limit)
        _impulses_of_world(w, model, parameters, V_P, states, impulses, status, work)


@entry_point
def inspect_step(model, parameters, V_P, states, limit, w):
    """Build and solve one step from the state of world w; see `diagnose.inspect`.

    Args:
        model, parameters, V_P, states, limit: as in `contact_impulses`, of one step.
        w: the world.

    Returns:
        Iterations (-1: not solved), contacts, system and solver work, whose dx is the residual of the solution.
    """
    bodies, contacts, system, solver, sweep = make_workspace(model, limit)
    mass, inertia, friction, restitution = parameters[0][w], parameters[1][w], parameters[2][w], parameters[3][w]
    load_geometry(model, bodies, parameters, w)
    load(bodies, model.num_bodies, model.num_kinematic > 0, states, 0, w)
    drive(bodies, model.num_bodies, model.num_kinematic > 0, V_P, 0, w)
    build_step(model, mass, inertia, friction, restitution, bodies, contacts, system)
    used = solve_step(model, friction, restitution, bodies, contacts, system, solver, sweep)
    negative_residual(system, contacts, solver, solver.dx)
    return used, contacts, system, solver


@entry_point
def select_worlds(model, parameters, V_P, states, limit):
    """Feature pairs of all worlds, padded to `limit` contacts.

    Args:
        model, parameters, V_P, states, limit: as in `contact_impulses`, of one step.

    Returns:
        count (W,), rows (W, limit, 16), body (W, limit, 2), pair (W, limit).
    """
    W, nb, has_pusher = V_P.shape[1], model.num_bodies, model.num_kinematic > 0
    count = np.zeros(W, np.int64)
    rows = np.zeros((W, limit, 16))
    body = np.zeros((W, limit, 2), np.int64)
    pair = np.zeros((W, limit), np.int64)
    bodies, contacts, _, _, _ = make_workspace(model, limit)
    for w in range(W):
        load_geometry(model, bodies, parameters, w)
        load(bodies, nb, has_pusher, states, 0, w)
        drive(bodies, nb, has_pusher, V_P, 0, w)
        for b in range(nb + model.num_kinematic):
            rotation_from_quaternion(bodies.q[b], bodies.R[b])
        select_features(model, bodies, contacts)
        count[w] = contacts.number[0]
        rows[w] = contacts.rows
        body[w] = contacts.body
        pair[w] = contacts.pair
    return count, rows, body, pair
