# SPDX-License-Identifier: MIT
"""Rollouts of many worlds, forward and backward (numba)."""

from pinwm_drake.jit import entry_point, kernel
from pinwm_drake.physics.kernels.adjoint import go_on, is_settled, remember, step_adjoint
from pinwm_drake.physics.kernels.impact import presses_apart
from pinwm_drake.physics.kernels.states import (
    drive,
    load,
    load_geometry,
    load_solution,
    store,
    store_solution,
)
from pinwm_drake.physics.kernels.step import HALVE, MOST_IMPACTS, SHORTEST, STRIKE, is_jammed, step_world
from pinwm_drake.physics.kernels.workspace import make_adjoint_work, make_workspace

# Status of a world after a rollout: the number of iterations it needed in all, or minus the failed step's number minus
# one; the constants are subtracted further where there were more contacts, or more parts of steps, than fit.
TOO_MANY_CONTACTS, TOO_MANY_PARTS = 1_000_000_000, 2_000_000_000
# Speeds, rad/s and m/s, of bodies that rest, under a pusher that rests.
RESTS = 1e-12
# Share of a step that is rounding.
NOTHING = 1e-12


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
def _forward_world(w, model, parameters, V_P, record_every, frames, saved, given, work):
    mass, inertia, friction, restitution = parameters[0][w], parameters[1][w], parameters[2][w], parameters[3][w]
    status, jams, lagged, early = frames[5][0], frames[5][1], frames[5][2], frames[5][3]
    states, saved_states = frames[:5], saved[:5]
    nb = model.num_bodies
    has_pusher = model.num_kinematic > 0
    slots, limit = saved[5].shape[0], saved[5].shape[2]
    bodies, contacts, system, solver, sweep = work
    load_geometry(model, bodies, parameters, w)
    load(bodies, nb, has_pusher, states, 0, w)
    total, slot = 0, 0
    jammed, lags, presses, alone = 0, 0, 0, False
    moved = _last_motion(V_P, w) if has_pusher else -1
    resting = 0
    for t in range(V_P.shape[0]):
        resting = resting + 1 if t > moved + 1 and _at_rest(bodies, nb) else 0
        if resting >= 2 and alone:
            # Nothing moves any more, and a step depends on its state alone. One step at rest is not enough: what is
            # thrown up rests for a moment.
            steps = V_P.shape[0]
            for frame in range(t // record_every + 1, steps // record_every + 1):
                store(bodies, nb, has_pusher, states, frame, w)
            first = t
            while slots > 0 and first < steps:
                if slot == slots:
                    status[w] = -first - 1 - TOO_MANY_PARTS
                    return
                last = min((first // record_every + 1) * record_every, steps)
                store(bodies, nb, has_pusher, saved_states, slot, w)
                store_solution(bodies, contacts, solver, saved, last - 1, slot, w, model.time_step, last - first)
                first, slot = last, slot + 1
            early[w] += presses * (steps - t)
            jams[w] += jammed * (steps - t)
            lagged[w] += lags * (steps - t)
            break
        drive(bodies, nb, has_pusher, V_P, t, w)
        left, length, impact, carried = model.time_step, model.time_step, False, False
        stops, jammed, lags, presses, after_impact = 0, 0, 0, 0, False
        while left > 0.0 or impact:
            bodies.time_step[0] = 0.0 if impact else min(length, left)
            if not impact:
                bodies.time_step[1] = bodies.time_step[0]
            if slots > 0:
                if slot == slots:
                    status[w] = -t - 1 - TOO_MANY_PARTS
                    return
                store(bodies, nb, has_pusher, saved_states, slot, w)
            used = step_world(
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
                impact,
                carried,
                stops < MOST_IMPACTS,
                stops < MOST_IMPACTS and not after_impact,
                length > SHORTEST * model.time_step,
                given,
            )
            full = contacts.number[0] == limit
            if full or used == -1:
                status[w] = -t - 1 - (TOO_MANY_CONTACTS if full else 0)
                return
            if used == HALVE:
                length = 0.5 * min(length, left)
                continue
            if used == STRIKE:
                impact, carried = True, False
                stops += 1
                continue
            total += used
            jammed = max(jammed, 1 if is_jammed(contacts, solver) else 0)
            lags = max(lags, solver.lagged[0])
            after_impact = impact
            impact = carried = solver.hit[0] >= 0
            stops += 1 if impact else 0
            presses = max(presses, 1 if presses_apart(contacts, solver.first) else 0)
            if slots > 0:
                store_solution(bodies, contacts, solver, saved, t, slot, w, left, 1)
                slot += 1
            alone = bodies.time_step[0] == model.time_step
            left -= bodies.time_step[0]
            if left < NOTHING * model.time_step:
                left = 0.0
            # A part's length is a fixed share of what is left, or a time of impact; see `time_adjoint.time_adjoint`.
            length = left if impact else length
        early[w] += presses
        jams[w] += jammed
        lagged[w] += lags
        if (t + 1) % record_every == 0:
            store(bodies, nb, has_pusher, states, (t + 1) // record_every, w)
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
    status, shares, steps, hits, repeats, slots = frames[5][0], saved[11], saved[12], saved[13], saved[14], saved[15]
    states, saved_states = frames[:5], saved[:5]
    q, q_P = frames[0], frames[3]
    q0_bar, p0_bar, V0_bar, q_P0_bar, p_P0_bar, V_P_bar = bars[7:]
    nb = model.num_bodies
    has_pusher = model.num_kinematic > 0
    bodies, contacts, system, solver, sweep = work
    load_geometry(model, bodies, parameters, w)
    after = V_P.shape[0]
    for s in range(slots[w] - 1, -1, -1):
        t = steps[s, w]
        if t != after:
            adjoint.left[0] = 0.0
            if (t + 1) % record_every == 0:
                _frame_gradient(adjoint, nb, has_pusher, states, frame_bars, (t + 1) // record_every, w)
        after = t
        later = s > 0 and steps[s - 1, w] == t
        end, at = (states, states[0].shape[0] - 1) if s + 1 == slots[w] else (saved_states, s + 1)
        for n in range(repeats[s, w]):
            if n > 0:
                adjoint.left[0] = 0.0
            drive(bodies, nb, has_pusher, V_P, t - n, w)
            load_solution(bodies, contacts, solver, saved, s, w)
            rest = repeats[s, w] - n - 1
            if rest > 0:
                remember(adjoint, theta_bar)
            if not step_adjoint(
                model,
                theta,
                theta_bar,
                bodies,
                contacts,
                system,
                solver,
                sweep,
                adjoint,
                saved_states,
                s,
                end,
                at,
                w,
                shares[s, w],
                later,
                later and hits[s - 1, w] >= 0,
            ):
                status[w] = -t - 1
                return
            settled = rest > 0 and is_settled(adjoint, nb, model.time_step)
            first = t - n - rest if settled else t - n
            if has_pusher:
                for i in range(6):
                    for step in range(first, t - n + 1):
                        V_P_bar[step, w, i] += adjoint.V[nb, i]
                    adjoint.V[nb, i] = 0.0
            if settled:
                go_on(adjoint, theta_bar, rest)
                break
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
def rollout_forward(model, parameters, V_P, record_every, frames, saved, given, first, last):
    """Roll out worlds first..last-1, without holding Python's lock.

    Args:
        model: ModelArrays.
        parameters: mass (W, nb), inertia (W, nb, 3, 3), friction and restitution (W, num_pairs), center and spread
            (W, nb, 3), offset (W, num_pairs).
        V_P: (T, W, 6), pusher velocities.
        record_every: steps between frames.
        frames: from `allocate_frames`, written from frame 1 on.
        saved: from `allocate_saved`, written if not empty.
        given: (W, num_pairs, 3), gains the impulses of each pair's contacts, on A, world frame, N s; or (W, 0, 3).
        first, last: range of worlds.
    """
    for w in range(first, last):
        work = make_workspace(model, saved[5].shape[2])
        _forward_world(w, model, parameters, V_P, record_every, frames, saved, given[w], work)


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
