# SPDX-License-Identifier: MIT
"""Worlds between the arrays of frames and the work arrays (numba)."""

import numpy as np

from pinwm_drake.jit import kernel

# The entry points allocate, and so count the references of all arrays that they touch, with locked instructions: half
# of a step's time where its loop is in them. What they call does not count (see `jit`).


@kernel
def load(bodies, nb, has_pusher, states, t, w):
    """State of world w at frame t, into the work arrays."""
    q, p, V, q_P, p_P = states
    for b in range(nb):
        for i in range(4):
            bodies.q[b, i] = q[t, w, b, i]
        for i in range(3):
            bodies.p[b, i] = p[t, w, b, i]
        for i in range(6):
            bodies.V[b, i] = V[t, w, b, i]
    if has_pusher:
        for i in range(4):
            bodies.q[nb, i] = q_P[t, w, i]
        for i in range(3):
            bodies.p[nb, i] = p_P[t, w, i]


@kernel
def store(bodies, nb, has_pusher, states, t, w):
    """State of world w from the work arrays, into frame t."""
    q, p, V, q_P, p_P = states
    for b in range(nb):
        for i in range(4):
            q[t, w, b, i] = bodies.q[b, i]
        for i in range(3):
            p[t, w, b, i] = bodies.p[b, i]
        for i in range(6):
            V[t, w, b, i] = bodies.V[b, i]
    if has_pusher:
        for i in range(4):
            q_P[t, w, i] = bodies.q[nb, i]
        for i in range(3):
            p_P[t, w, i] = bodies.p[nb, i]


@kernel
def load_geometry(model, bodies, parameters, w):
    """Geometry of world w: centres of mass, spreads of pressure and offsets."""
    for b in range(model.num_bodies):
        for i in range(3):
            bodies.center[b, i] = parameters[4][w, b, i]
            bodies.spread[b, i] = parameters[5][w, b, i]
    for k in range(model.num_pairs):
        bodies.offset[k] = parameters[6][w, k]


@kernel
def drive(bodies, nb, has_pusher, V_P, t, w):
    """Velocity of world w's pusher in step t, into the work arrays."""
    if has_pusher:
        for i in range(6):
            bodies.V[nb, i] = V_P[t, w, i]


@kernel
def store_solution(bodies, contacts, solver, saved, t, s, w, left, times):
    """Store what slot s needs beside its state; the step has `left` seconds to go at its start.

    A slot stands for `times` equal steps, of which t is the last.
    """
    first, modes, u, elastic, lengths, spans, shares, steps, hits, repeats, used = saved[5:]
    for c in range(contacts.number[0]):
        first[s, w, c], modes[s, w, c] = solver.first[c], solver.mode[c]
    for i in range(u.shape[2]):
        u[s, w, i] = solver.u[i]
    elastic[s, w] = contacts.elastic[0]
    lengths[s, w], spans[s, w] = bodies.time_step[0], bodies.time_step[1]
    shares[s, w] = bodies.time_step[0] / left if left > 0.0 else 0.0
    steps[s, w], hits[s, w], repeats[s, w] = t, solver.hit[0], times
    used[w] = s + 1


@kernel
def load_solution(bodies, contacts, solver, saved, s, w):
    """Solution of slot s, without the state after it."""
    first, modes, u, elastic, lengths, spans, _, _, hits, _, _ = saved[5:]
    for c in range(modes.shape[2]):
        solver.first[c], solver.mode[c] = first[s, w, c], modes[s, w, c]
    for i in range(u.shape[2]):
        solver.u[i] = u[s, w, i]
    contacts.elastic[0] = elastic[s, w]
    bodies.time_step[0], bodies.time_step[1] = lengths[s, w], spans[s, w]
    solver.hit[0] = hits[s, w]


def allocate_frames(
    q: np.ndarray, p: np.ndarray, V: np.ndarray, q_P: np.ndarray, p_P: np.ndarray, num_frames: int
) -> tuple[np.ndarray, ...]:
    """Frame arrays (num_frames, W, ...) from the initial state on; status, jams, lagged and early steps (4, W)."""
    arrays = []
    for first in (q, p, V, q_P, p_P):
        array = np.empty((num_frames, *first.shape))
        # All frames: kernels write no pusher where there is none.
        array[:] = first
        arrays.append(array)
    return (*arrays, np.zeros((4, q.shape[0]), np.int64))


def allocate_saved(num_slots: int, num_worlds: int, num_bodies: int, max_contacts: int) -> tuple[np.ndarray, ...]:
    """Arrays for the backward pass, with a slot for each part of a step; empty if there are no slots.

    They are the states at the start of the parts; modes of contacts in both stages, velocities of the position stage,
    shares of bounces, lengths, these before times of impact [s], shares of what was left of the step, numbers of the
    step and of the contact that ended it, and of equal steps up to it; and how many slots each world used.
    """
    S, W = num_slots, num_worlds
    return (
        np.empty((S, W, num_bodies, 4)),
        np.empty((S, W, num_bodies, 3)),
        np.empty((S, W, num_bodies, 6)),
        np.empty((S, W, 4)),
        np.empty((S, W, 3)),
        np.zeros((S, W, max_contacts), np.uint8),
        np.zeros((S, W, max_contacts), np.uint8),
        np.empty((S, W, 6 * num_bodies)),
        np.empty((S, W)),
        np.empty((S, W)),
        np.empty((S, W)),
        np.empty((S, W)),
        np.empty((S, W), np.int64),
        np.empty((S, W), np.int64),
        np.empty((S, W), np.int64),
        np.zeros(W, np.int64),
    )
