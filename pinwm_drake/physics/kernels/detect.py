# SPDX-License-Identifier: MIT
"""Finds a step's contacts and turns them into rows of its equations (numba)."""

from pinwm_drake.geometry.contact.narrowphase import collide_bodies, collide_floor
from pinwm_drake.geometry.features import contact_from_features, tangents
from pinwm_drake.geometry.vectors import cross, norm
from pinwm_drake.jit import large_kernel, part_of_kernel, small_kernel
from pinwm_drake.physics.kernels.cone import NO_LIMIT
from pinwm_drake.physics.kernels.stabilise import SLOP

# The gap that a closing contact may leave open fades out with restitution as (1 - e)^FADE: an inelastic contact
# lands exactly on the surface, an elastic one bounces from where it is, which keeps its speed.
FADE = 32
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
    """Run the narrow phase on all pairs; fill contacts.rows, body, dynamic, pair and count."""
    nb, h, g = model.num_bodies, bodies.time_step[0], model.gravity
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
                    model.table, A, bodies.spread[A], R[A], place[A], model.floor_height, margin, rows, count
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
def rebound(model, bodies, contacts, c, e):
    """Speed with which contact c leaves a bounce, m/s, and whether it bounces.

    It is Newton's e |approach|, less what gravity takes in the step; where gravity takes all, nothing bounces.
    Without that loss a bounce would gain the energy m g h e |approach|, because it rises for a whole step.
    """
    if contacts.closing[c] == 0.0 or contacts.approach[c] >= 0.0:
        return 0.0, False
    speed, loss = -e * contacts.approach[c], 0.0
    if contacts.dynamic[c, 1] < 0:
        n, g = contacts.frame[c, 0], model.gravity
        loss = max(-bodies.time_step[0] * (n[0] * g[0] + n[1] * g[1] + n[2] * g[2]), 0.0)
    if speed + LEAST_REBOUND <= loss:
        return 0.0, False
    return (speed - loss if e > 0.0 else 0.0), True


@small_kernel
def build_rows(model, friction, restitution, bodies, contacts, system):
    """Fill frames, levers, Jacobians and biases of the selected contacts.

    Args:
        friction: (num_pairs,).
        restitution: (num_pairs,), in [0, 1].
    """
    h = bodies.time_step[0]
    for c in range(contacts.number[0]):
        A, B = contacts.body[c, 0], contacts.body[c, 1]
        contacts.limit[c] = NO_LIMIT
        if model.num_bodies == B:
            sharing = 0
            for other in range(contacts.number[0]):
                sharing += 1 if contacts.body[other, 0] == A and contacts.body[other, 1] == B else 0
            contacts.limit[c] = model.impact_impulse[A] + model.pusher_force * h / sharing
        a, b = contacts.witness[c, 0], contacts.witness[c, 1]
        frame, lever, J = contacts.frame[c], contacts.lever[c], contacts.J[c]
        gap = contact_from_features(
            contacts.rows[c], bodies.R[A], bodies.p[A], bodies.R[B], bodies.p[B], frame[0], a, b
        )
        gap -= bodies.offset[contacts.pair[c]]
        contacts.gap[c] = gap
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
        approach = 0.0
        for i in range(6):
            approach += J[0, 0, i] * bodies.V[A, i] + J[1, 0, i] * bodies.V[B, i]
        free = 0.0
        for i in range(6):
            free += J[0, 0, i] * system.free[6 * A + i]
            free += J[1, 0, i] * (system.free[6 * B + i] if model.num_bodies > B else bodies.V[B, i])
        contacts.approach[c] = approach
        closing = 1.0 if gap + h * free < 0.0 else 0.0
        contacts.closing[c] = closing
        e = restitution[contacts.pair[c]]
        keep = 1.0 - closing * (1.0 - (1.0 - e) ** FADE)
        contacts.rebound[c], _ = rebound(model, bodies, contacts, c, e)
        contacts.bias[c, 0] = keep * max(gap, -SLOP) / h - contacts.elastic[0] * contacts.rebound[c]
        contacts.bias[c, 1], contacts.bias[c, 2] = 0.0, 0.0
        if model.num_bodies == B:
            for i in range(3):
                total = 0.0
                for j in range(6):
                    total += J[1, i, j] * bodies.V[B, j]
                contacts.bias[c, i] += total
        contacts.mu[c] = friction[contacts.pair[c]]


@large_kernel
def rebuild_rows(model, friction, restitution, bodies, contacts, system):
    """`build_rows`, where it is not needed at every step."""
    build_rows(model, friction, restitution, bodies, contacts, system)
