# SPDX-License-Identifier: MIT
"""Finds a step's contacts and turns them into rows of its equations (numba)."""

from pinwm_drake.geometry.contact.narrowphase import collide_bodies, collide_floor
from pinwm_drake.geometry.features import POINT, contact_from_features, tangents
from pinwm_drake.geometry.vectors import cross, norm
from pinwm_drake.jit import kernel, part_of_kernel, small_kernel
from pinwm_drake.physics.kernels.cone import NO_LIMIT, OPEN
from pinwm_drake.physics.kernels.curve import curve, floor_curve, move_halfway
from pinwm_drake.physics.kernels.dynamics import (
    IMPACT,
    POSITION,
    VELOCITY,
)
from pinwm_drake.physics.kernels.stabilise import SLOP

# A gap smaller than this touches, m. So does one that closes within a step at less than this speed, m/s, as far as
# times of impact go.
TOUCHING, SLOW = 1e-6, 2.5e-4
# What a row that is left out in a step is: away, until its time of impact, or beside the body.
AWAY, BESIDE = 1, 2
# Slack of a row that is left out, m/s.
_OPEN = 1.0
# A contact that gravity does not press together bounces at any restitution, e = 0 included, so that the derivative
# with respect to e is there; this much of a press is rounding, m/s.
LEAST_REBOUND = 1e-9


@small_kernel
def _speed_bound(model, bodies, b):
    """Bound on the speed of any point of body b, m/s."""
    V = bodies.V[b]
    return norm(V[3], V[4], V[5]) + model.radius[b] * norm(V[0], V[1], V[2])


@small_kernel
def place_pieces(model, center, R, p, place):
    """Write the origins of the pieces' frames into place (N, 3), from poses (R, p) of the bodies, m."""
    for b in range(model.num_bodies + model.num_kinematic):
        for i in range(3):
            place[b, i] = p[b, i] - (R[b, i, 0] * center[b, 0] + R[b, i, 1] * center[b, 1] + R[b, i, 2] * center[b, 2])


@part_of_kernel
def select_features(model, bodies, contacts):
    """Run the narrow phase on all pairs, for bodies.time_step[1]; fill rows, body, dynamic, pair and number."""
    nb, h, g = model.num_bodies, bodies.time_step[1], model.gravity
    R, place, rows = bodies.R, bodies.place, contacts.rows
    fall = h * norm(g[0], g[1], g[2])
    count = 0
    place_pieces(model, bodies.center, R, bodies.p, place)
    for A in range(nb):
        speed_A, hit = _speed_bound(model, bodies, A) + fall, 0.0
        for B in range(A + 1, nb + 2):
            pair = model.pair_index[A, B]
            if pair < 0:
                continue
            first = count
            if nb + 1 == B:
                # A body that lands on one end may come down twice as fast with the other.
                margin = model.margin + h * (2.0 * speed_A + hit) + max(bodies.offset[pair], 0.0)
                count = collide_floor(
                    model.table,
                    A,
                    bodies.spread[A],
                    R[A],
                    place[A],
                    bodies.V[A],
                    h,
                    model.floor_height,
                    margin,
                    rows,
                    count,
                )
            else:
                speed_B = _speed_bound(model, bodies, B) + (fall if nb > B else 0.0)
                margin = model.margin + h * (speed_A + speed_B) + max(bodies.offset[pair], 0.0)
                count = collide_bodies(model.table, A, R[A], place[A], B, R[B], place[B], margin, rows, count)
                if nb == B and count > first:
                    # What the pusher hits may turn about its corners, up to twice as fast where it is long.
                    hit = 2.0 * speed_B
            for c in range(first, count):
                contacts.body[c, 0], contacts.body[c, 1] = A, B
                contacts.dynamic[c, 0], contacts.dynamic[c, 1] = A, B if nb > B else -1
                contacts.pair[c] = pair
                # From the pieces' frame to B, whose origin is the centre of mass.
                for i in range(3):
                    rows[c, 1 + i] -= bodies.center[A, i]
                    rows[c, 9 + i] -= bodies.center[B, i]
    contacts.number[0] = count


@small_kernel
def rebound(model, contacts, c, e):
    """Speed with which contact c leaves a bounce, m/s, and whether it bounces: Newton's e |approach|.

    A bounce that gravity would bring back within a step is none.
    """
    speed, loss = -e * contacts.approach[c], 0.0
    if contacts.approach[c] >= 0.0:
        return 0.0, False
    if contacts.dynamic[c, 1] < 0:
        n, g = contacts.frame[c, 0], model.gravity
        loss = max(-model.time_step * (n[0] * g[0] + n[1] * g[1] + n[2] * g[2]), 0.0)
    if speed + LEAST_REBOUND <= loss:
        return 0.0, False
    return speed, True


@kernel
def half_force(model, contacts, c):
    """Half of the largest force with which the pusher presses at its contact c, N."""
    sharing = 0
    for other in range(contacts.number[0]):
        same = contacts.body[other, 0] == contacts.body[c, 0] and contacts.body[other, 1] == contacts.body[c, 1]
        sharing += 1 if same else 0
    return 0.5 * model.pusher_force / sharing


@small_kernel
def build_rows(model, friction, restitution, bodies, contacts, sweep, first, stage):
    """Fill frames, levers, Jacobians and biases of the selected contacts.

    In the position stage a contact may close by its gap. To second order that is gap + h J u + h (J_m V - J V), with
    J_m after half of the step with the velocities V before it; likewise for its tangents. In the velocity stage what
    touches before and after the step does not close, and in an impact all that touches does not, or bounces.

    Args:
        friction: (num_pairs,).
        restitution: (num_pairs,), in [0, 1].
        first: (C,), modes of the position stage, for the velocity stage.
        stage: POSITION, VELOCITY or IMPACT.
    """
    h, H = bodies.time_step[0], model.time_step
    if stage == POSITION and contacts.number[0] > 0:
        move_halfway(model, bodies, sweep, 0.5 * h)
    for c in range(contacts.number[0]):
        A, B = contacts.body[c, 0], contacts.body[c, 1]
        a, b = contacts.witness[c, 0], contacts.witness[c, 1]
        frame, lever, J, bias = contacts.frame[c], contacts.lever[c], contacts.J[c], contacts.bias[c]
        gap = contact_from_features(
            contacts.rows[c], bodies.R[A], bodies.p[A], bodies.R[B], bodies.p[B], frame[0], a, b
        )
        gap -= bodies.offset[contacts.pair[c]]
        contacts.gap[c] = gap
        pressed = stage == VELOCITY and first[c] != OPEN
        if stage != VELOCITY:
            contacts.closed[c] = 1 if gap <= SLOW * H else 0
        if stage != POSITION and not pressed and (contacts.closed[c] == 0 or (stage == VELOCITY and gap > TOUCHING)):
            switch_off(contacts, c)
            continue
        _set_limit(model, bodies, contacts, c, stage)
        t = tangents(frame[0, 0], frame[0, 1], frame[0, 2])
        frame[1, 0], frame[1, 1], frame[1, 2], frame[2, 0], frame[2, 1], frame[2, 2] = t
        for i in range(3):
            point = 0.5 * (a[i] + b[i])
            lever[0, i] = point - bodies.p[A, i]
            lever[1, i] = point - bodies.p[B, i]
        for side in range(2):
            sign = 1.0 if side == 0 else -1.0
            rx, ry, rz = sign * lever[side, 0], sign * lever[side, 1], sign * lever[side, 2]
            for i in range(3):
                dx, dy, dz = frame[i, 0], frame[i, 1], frame[i, 2]
                J[side, i, 0], J[side, i, 1], J[side, i, 2] = cross(rx, ry, rz, dx, dy, dz)
                J[side, i, 3], J[side, i, 4], J[side, i, 5] = sign * dx, sign * dy, sign * dz
        _begin_bias(model, bodies, contacts, c)
        contacts.mu[c] = friction[contacts.pair[c]]
        contacts.rebound[c] = 0.0
        if stage == VELOCITY:
            bias[0] += min(max(gap, -SLOP), 0.0) / H
            continue
        approach = 0.0
        for i in range(6):
            approach += J[0, 0, i] * bodies.V[A, i] + J[1, 0, i] * bodies.V[B, i]
        contacts.approach[c] = approach
        if stage == IMPACT:
            contacts.rebound[c], _ = rebound(model, contacts, c, restitution[contacts.pair[c]])
            bias[0] += min(max(gap, -SLOP), 0.0) / H - contacts.elastic[0] * contacts.rebound[c]
            continue
        _close_by_gap(model, bodies, contacts, sweep, c)


@small_kernel
def _set_limit(model, bodies, contacts, c, stage):
    """Largest normal impulse of contact c, which the pusher's force bounds."""
    contacts.limit[c] = NO_LIMIT
    if model.num_bodies == contacts.body[c, 1]:
        contacts.limit[c] = half_force(model, contacts, c) * bodies.time_step[0]
        if stage != VELOCITY:
            contacts.limit[c] += model.impact_impulse[contacts.body[c, 0]]


@small_kernel
def _begin_bias(model, bodies, contacts, c):
    """Bias of contact c by the pusher's velocity; no curve."""
    bias, J, B = contacts.bias[c], contacts.J[c], contacts.body[c, 1]
    for i in range(3):
        bias[i] = contacts.curve[c, i] = 0.0
        if model.num_bodies == B:
            for j in range(6):
                bias[i] += J[1, i, j] * bodies.V[B, j]


@small_kernel
def _close_by_gap(model, bodies, contacts, sweep, c):
    """Add to the bias of contact c in the position stage its gap, and what levers that turn make."""
    gap, bias, frame = contacts.gap[c], contacts.bias[c], contacts.frame[c]
    A, B = contacts.body[c, 0], contacts.body[c, 1]
    bias[0] += gap / bodies.time_step[0] if gap > 0.0 else max(gap, -SLOP) / model.time_step
    if sweep.turns[0] == 1:
        if model.num_bodies + 1 == B and int(contacts.rows[c, 0]) == POINT:
            x, y, z = floor_curve(contacts.rows[c], bodies.V[A], sweep.R[A], sweep.p[A], frame, contacts.lever[c, 0])
        else:
            x, y, z = curve(bodies, contacts, sweep, c)
        bias[0], bias[1], bias[2] = bias[0] + x, bias[1] + y, bias[2] + z
        contacts.curve[c, 0], contacts.curve[c, 1], contacts.curve[c, 2] = x, y, z


@small_kernel
def switch_off(contacts, c):
    """Make contact c stay open whatever happens."""
    for i in range(2):
        for j in range(3):
            for k in range(6):
                contacts.J[c, i, j, k] = 0.0
    contacts.mu[c] = 0.0
    contacts.rebound[c] = 0.0
    contacts.bias[c, 0], contacts.bias[c, 1], contacts.bias[c, 2] = _OPEN, 0.0, 0.0


@kernel
def change_length(model, bodies, contacts, sweep):
    """Rows of the position stage that are not left out, after its length has changed: their limits and biases."""
    move_halfway(model, bodies, sweep, 0.5 * bodies.time_step[0])
    for c in range(contacts.number[0]):
        if sweep.out[c] == 0:
            _set_limit(model, bodies, contacts, c, POSITION)
            _begin_bias(model, bodies, contacts, c)
            _close_by_gap(model, bodies, contacts, sweep, c)
