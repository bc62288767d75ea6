# SPDX-License-Identifier: MIT
"""Contacts of recorded states: the narrow phase, and parts of a step laid open (numba)."""

import numpy as np

from pinwm_drake.jit import entry_point
from pinwm_drake.physics.kernels.cone import negative_residual
from pinwm_drake.physics.kernels.detect import select_features
from pinwm_drake.physics.kernels.dynamics import rotation_from_quaternion
from pinwm_drake.physics.kernels.recall import recall_contacts, recall_stage
from pinwm_drake.physics.kernels.states import drive, load, load_geometry, load_solution
from pinwm_drake.physics.kernels.workspace import make_workspace


@entry_point
def recall_part(model, parameters, V_P, saved, end, s, at, carried, stage):
    """Recall a stage of a part of a step of one world; see `diagnose.inspect`.

    Args:
        model: ModelArrays.
        parameters: as in `rollout.rollout_forward`.
        V_P: (1, 1, 6), pusher velocity.
        saved: from `states.allocate_saved`, of the rollout.
        end: states after the part, at frame `at`.
        s: number of the part.
        at: see `end`.
        carried: whether it is an impact of contacts of the part before.
        stage: POSITION, VELOCITY or IMPACT.

    Returns:
        Whether its matrix is regular; contacts, system and solver work of that stage, whose dx is its residual.
    """
    bodies, contacts, system, solver, sweep = make_workspace(model, saved[5].shape[2])
    theta = (parameters[0][0], parameters[1][0], parameters[2][0], parameters[3][0])
    start = saved[:5]
    load_geometry(model, bodies, parameters, 0)
    drive(bodies, model.num_bodies, model.num_kinematic > 0, V_P, 0, 0)
    load_solution(bodies, contacts, solver, saved, s, 0)
    recall_contacts(model, bodies, contacts, solver, start, s - 1 if carried else s, 0)
    regular = recall_stage(model, theta, bodies, contacts, system, solver, sweep, start, s, end, at, 0, stage)
    negative_residual(system, contacts, solver, solver.dx)
    return regular, contacts, system, solver


@entry_point
def select_worlds(model, parameters, V_P, states, limit, spans):
    """Feature pairs of all worlds, padded to `limit` contacts.

    Args:
        model: ModelArrays.
        parameters: as in `rollout.rollout_forward`.
        V_P: (1, W, 6), pusher velocities.
        states: q, p, V, q_P and p_P of a frame, as from `states.allocate_frames`.
        limit: rows of the contact tables.
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
