# SPDX-License-Identifier: MIT
"""Rollouts of many worlds, forward and backward (numba)."""

import numpy as np

from pinwm_drake.jit import entry_point, kernel
from pinwm_drake.physics.kernels.adjoint import step_adjoint
from pinwm_drake.physics.kernels.step import HALVE, MOST_PARTS, is_jammed, step_world
from pinwm_drake.physics.kernels.workspace import make_adjoint_work, make_workspace

# Status of a world after a rollout: the number of iterations it needed in all, or minus the failed step's number minus
# one; the constants are subtracted further where there were more contacts, or more parts of steps, than fit.
TOO_MANY_CONTACTS, TOO_MANY_PARTS = 1_000_000_000, 2_000_000_000
# Speeds, rad/s and m/s, of bodies that rest, under a pusher that rests.
RESTS = 1e-12


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
def _store(bodies, nb, has_pusher, states, t, w):
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
def _store_solution(bodies, contacts, solver, saved, t, s, w):
    """Store what slot s needs beside its state: modes, share of the bounces, length and number of the step."""
    modes, elastic, lengths, steps, used = saved[5:]
    for c in range(contacts.number[0]):
        modes[s, w, c] = solver.mode[c]
    elastic[s, w] = contacts.elastic[0]
    lengths[s, w] = bodies.time_step[0]
    steps[s, w] = t
    used[w] = s + 1


@kernel
def _load_solution(bodies, contacts, solver, nb, states, saved, s, w):
    """Velocities and modes that slot s found: the velocities are those of the state after it."""
    modes, elastic, lengths, _, used = saved[5:]
    V, at = (states[2], states[2].shape[0] - 1) if s + 1 == used[w] else (saved[2], s + 1)
    for b in range(nb):
        for i in range(6):
            solver.x[6 * b + i] = V[at, w, b, i]
    for c in range(modes.shape[2]):
        solver.mode[c] = modes[s, w, c]
    contacts.elastic[0] = elastic[s, w]
    bodies.time_step[0] = lengths[s, w]


@kernel
def _last_motion(V_P, w):
    """Return the number of the last step in which the pusher moves; -1 where it never does."""
    for t in range(V_P.shape[0] - 1, -1, -1):
        for i in range(6):
            if V_P[t, w, i] != 0.0:
                return t
    return -1


@kernel
def _at_rest(bodies, nb):
    for b in range(nb):
        for i in range(6):
            if abs(bodies.V[b, i]) > RESTS:
                return False
    return True


@kernel
def _forward_world(w, model, parameters, V_P, record_every, frames, saved, work):
    mass, inertia, friction, restitution = parameters[0][w], parameters[1][w], parameters[2][w], parameters[3][w]
    status, jams, lagged = frames[5][0], frames[5][1], frames[5][2]
    states, saved_states = frames[:5], saved[:5]
    nb = model.num_bodies
    has_pusher = model.num_kinematic > 0
    slots, limit = saved[5].shape[0], saved[5].shape[2]
    bodies, contacts, system, solver, sweep = work
    load_geometry(model, bodies, parameters, w)
    load(bodies, nb, has_pusher, states, 0, w)
    total, slot = 0, 0
    moved = _last_motion(V_P, w) if has_pusher else -1
    resting = 0
    for t in range(V_P.shape[0]):
        resting = resting + 1 if t > moved + 1 and _at_rest(bodies, nb) else 0
        if slots == 0 and resting == 2:
            # Nothing moves any more, and a step depends on its state alone. One step at rest is not enough: what is
            # thrown up rests for a moment.
            for frame in range(t // record_every + 1, V_P.shape[0] // record_every + 1):
                _store(bodies, nb, has_pusher, states, frame, w)
            break
        drive(bodies, nb, has_pusher, V_P, t, w)
        part, parts, jammed, lags = 0, 1, 0, 0
        while part < parts:
            bodies.time_step[0] = model.time_step / parts
            if slots > 0:
                if slot == slots:
                    status[w] = -t - 1 - TOO_MANY_PARTS
                    return
                _store(bodies, nb, has_pusher, saved_states, slot, w)
            used = step_world(
                model, mass, inertia, friction, restitution, bodies, contacts, system, solver, sweep, parts < MOST_PARTS
            )
            full = contacts.number[0] == limit
            if full or used == -1:
                status[w] = -t - 1 - (TOO_MANY_CONTACTS if full else 0)
                return
            if used == HALVE:
                part, parts = 2 * part, 2 * parts
                continue
            total += used
            jammed = max(jammed, 1 if is_jammed(contacts, solver) else 0)
            lags = max(lags, solver.lagged[0])
            if slots > 0:
                _store_solution(bodies, contacts, solver, saved, t, slot, w)
                slot += 1
            part += 1
        jams[w] += jammed
        lagged[w] += lags
        if (t + 1) % record_every == 0:
            _store(bodies, nb, has_pusher, states, (t + 1) // record_every, w)
    status[w] = total


@kernel
def _frame_gradient(adjoint, nb, has_pusher, states, bars, f, w):
    """Add the loss's gradient at a recorded frame; quaternion gradients become rotation-vector gradients."""
    q, _, _, q_P, _ = states
    q_bar, p_bar, V_bar, q_P_bar, p_P_bar = bars
    for b in range(nb + (1 if has_pusher else 0)):
        if b < nb:
            s, g, t = q[f, w, b], q_bar[f, w, b], p_bar[f, w, b]
        else:
            s, g, t = q_P[f, w], q_P_bar[f, w], p_P_bar[f, w]
        c, x, y, z = s[0], s[1], s[2], s[3]
        # d/dtheta of (0, theta) q / 2
        adjoint.pose[b, 0] += 0.5 * (-g[0] * x + g[1] * c - g[2] * z + g[3] * y)
        adjoint.pose[b, 1] += 0.5 * (-g[0] * y + g[1] * z + g[2] * c - g[3] * x)
        adjoint.pose[b, 2] += 0.5 * (-g[0] * z - g[1] * y + g[2] * x + g[3] * c)
        for i in range(3):
            adjoint.pose[b, 3 + i] += t[i]
        if b < nb:
            for i in range(6):
                adjoint.V[b, i] += V_bar[f, w, b, i]


@kernel
def _quaternion_gradient(theta_bar, q, q_bar):
    """Ambient gradient of a rotation-vector gradient: theta = 2 Im(dq q*)."""
    w, x, y, z = q[0], q[1], q[2], q[3]
    a, b, c = 2.0 * theta_bar[0], 2.0 * theta_bar[1], 2.0 * theta_bar[2]
    q_bar[0] = -a * x - b * y - c * z
    q_bar[1] = a * w + b * z - c * y
    q_bar[2] = -a * z + b * w + c * x
    q_bar[3] = a * y - b * x + c * w


@kernel
def _backward_world(w, model, parameters, V_P, record_every, frames, saved, frame_bars, bars, work, adjoint):
    theta = (parameters[0][w], parameters[1][w], parameters[2][w], parameters[3][w])
    theta_bar = (bars[0][w], bars[1][w], bars[2][w], bars[3][w])
    status, steps, slots = frames[5][0], saved[8], saved[9]
    states, saved_states = frames[:5], saved[:5]
    q, q_P = frames[0], frames[3]
    q0_bar, p0_bar, V0_bar, q_P0_bar, p_P0_bar, V_P_bar = bars[7:]
    nb = model.num_bodies
    has_pusher = model.num_kinematic > 0
    bodies, contacts, system, solver, _ = work
    load_geometry(model, bodies, parameters, w)
    after = V_P.shape[0]
    for s in range(slots[w] - 1, -1, -1):
        t = steps[s, w]
        if t != after and (t + 1) % record_every == 0:
            _frame_gradient(adjoint, nb, has_pusher, states, frame_bars, (t + 1) // record_every, w)
        after = t
        load(bodies, nb, has_pusher, saved_states, s, w)
        drive(bodies, nb, has_pusher, V_P, t, w)
        _load_solution(bodies, contacts, solver, nb, states, saved, s, w)
        if not step_adjoint(model, theta, theta_bar, bodies, contacts, system, solver, adjoint):
            status[w] = -t - 1
            return
        if has_pusher:
            for i in range(6):
                V_P_bar[t, w, i] += adjoint.V[nb, i]
                adjoint.V[nb, i] = 0.0
    _frame_gradient(adjoint, nb, has_pusher, states, frame_bars, 0, w)
    for k in range(model.num_pairs):
        bars[6][w, k] = adjoint.offset[k]
    for b in range(nb):
        for i in range(3):
            bars[4][w, b, i] = adjoint.center[b, i]
            bars[5][w, b, i] = adjoint.spread[b, i]
        _quaternion_gradient(adjoint.pose[b], q[0, w, b], q0_bar[w, b])
        for i in range(3):
            p0_bar[w, b, i] = adjoint.pose[b, 3 + i]
        for i in range(6):
            V0_bar[w, b, i] = adjoint.V[b, i]
    if has_pusher:
        _quaternion_gradient(adjoint.pose[nb], q_P[0, w], q_P0_bar[w])
        for i in range(3):
            p_P0_bar[w, i] = adjoint.pose[nb, 3 + i]


@entry_point
def rollout_forward(model, parameters, V_P, record_every, frames, saved, first, last):
    """Roll out worlds first..last-1, without holding Python's lock.

    Args:
        model: ModelArrays.
        parameters: mass (W, nb), inertia (W, nb, 3, 3), friction and restitution (W, num_pairs), center and spread
            (W, nb, 3), offset (W, num_pairs).
        V_P: (T, W, 6), pusher velocities.
        record_every: steps between frames.
        frames: from `allocate_frames`, written from frame 1 on.
        saved: from `allocate_saved`, written if not empty.
        first, last: range of worlds.
    """
    for w in range(first, last):
        work = make_workspace(model, saved[5].shape[2])
        _forward_world(w, model, parameters, V_P, record_every, frames, saved, work)


@entry_point
def rollout_backward(model, parameters, V_P, record_every, frames, saved, frame_bars, bars, first, last):
    """Pull gradients back through worlds first..last-1, without holding Python's lock.

    Args:
        model, parameters, V_P, record_every, frames, saved, first, last: as in `rollout_forward`.
        frame_bars: gradients with respect to the five frame arrays.
        bars: receive the gradients with respect to the parameters, the initial state and V_P.
    """
    for w in range(first, last):
        work, adjoint = make_workspace(model, saved[5].shape[2]), make_adjoint_work(model)
        _backward_world(w, model, parameters, V_P, record_every, frames, saved, frame_bars, bars, work, adjoint)


def allocate_frames(
    q: np.ndarray, p: np.ndarray, V: np.ndarray, q_P: np.ndarray, p_P: np.ndarray, num_frames: int
) -> tuple[np.ndarray, ...]:
    """Frame arrays (num_frames, W, ...) from the initial state on; status, jams and lagged steps (3, W)."""
    arrays = []
    for first in (q, p, V, q_P, p_P):
        array = np.empty((num_frames, *first.shape))
        # All frames: kernels write no pusher where there is none.
        array[:] = first
        arrays.append(array)
    return (*arrays, np.zeros((3, q.shape[0]), np.int64))


def allocate_saved(num_slots: int, num_worlds: int, num_bodies: int, max_contacts: int) -> tuple[np.ndarray, ...]:
    """Arrays for the backward pass, with a slot for each part of a step; empty if there are no slots.

    They are the states, modes of contacts, shares of bounces, lengths of the parts [s], numbers of the steps that they
    belong to, and how many slots each world used.
    """
    S, W = num_slots, num_worlds
    return (
        np.empty((S, W, num_bodies, 4)),
        np.empty((S, W, num_bodies, 3)),
        np.empty((S, W, num_bodies, 6)),
        np.empty((S, W, 4)),
        np.empty((S, W, 3)),
        np.zeros((S, W, max_contacts), np.uint8),
        np.empty((S, W)),
        np.empty((S, W)),
        np.empty((S, W), np.int64),
        np.zeros(W, np.int64),
    )
