# SPDX-License-Identifier: MIT
"""Contacts of recorded states: the narrow phase, and one step laid open (numba)."""

import numpy as np

from pinwm_drake.jit import entry_point
from pinwm_drake.physics.kernels.cone import negative_residual
from pinwm_drake.physics.kernels.detect import select_features
from pinwm_drake.physics.kernels.dynamics import POSITION, VELOCITY, rotation_from_quaternion
from pinwm_drake.physics.kernels.solve import solve_again
from pinwm_drake.physics.kernels.states import drive, load, load_geometry
from pinwm_drake.physics.kernels.step import advance, build_stage
from pinwm_drake.physics.kernels.workspace import make_workspace


@entry_point
def inspect_step(model, parameters, V_P, states, limit, w, last):
    """Build and solve the stages of one step from the state of world w; see `diagnose.inspect`.

    Args:
        model: ModelArrays.
        parameters: as in `rollout.rollout_forward`.
        V_P: (1, W, 6), pusher velocities.
        states: q, p, V, q_P and p_P of a frame, as from `states.allocate_frames`.
        limit: rows of the contact tables.
        w: the world.
        last: the stage to end with, POSITION or VELOCITY.

    Returns:
        Iterations (-1: not solved), contacts, system and solver work of that stage, whose dx is its residual.
    """
    bodies, contacts, system, solver, sweep = make_workspace(model, limit)
    mass, inertia, friction, restitution = parameters[0][w], parameters[1][w], parameters[2][w], parameters[3][w]
    load_geometry(model, bodies, parameters, w)
    load(bodies, model.num_bodies, model.num_kinematic > 0, states, 0, w)
    drive(bodies, model.num_bodies, model.num_kinematic > 0, V_P, 0, w)
    used = 0
    for stage in range(last + 1):
        if stage == VELOCITY:
            advance(model, bodies, contacts, system, solver)
        build_stage(
            model,
            mass,
            inertia,
            friction,
            restitution,
            bodies,
            contacts,
            system,
            solver,
            sweep,
            stage,
            stage == POSITION,
        )
        more = solve_again(bodies, system, contacts, solver, stage)
        if more < 0:
            return -1, contacts, system, solver
        used += more
        if stage == POSITION:
            for c in range(contacts.number[0]):
                solver.first[c] = solver.mode[c]
    negative_residual(system, contacts, solver, solver.dx)
    return used, contacts, system, solver


@entry_point
def select_worlds(model, parameters, V_P, states, limit, spans):
    """Feature pairs of all worlds, padded to `limit` contacts.

    Args:
        model, parameters, V_P, states, limit: as in `inspect_step`.
        spans: (W,), times for which contacts are selected, s.

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
        bodies.time_step[1] = spans[w]
        select_features(model, bodies, contacts)
        count[w] = contacts.number[0]
        rows[w] = contacts.rows
        body[w] = contacts.body
        pair[w] = contacts.pair
    return count, rows, body, pair
