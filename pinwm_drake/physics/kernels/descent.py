# SPDX-License-Identifier: MIT
"""Descent to the solution of a step whose friction has bounds that are given (numba).

With |lambda_t| <= radius in place of mu lambda_n, a step is the minimum of a strictly convex function of x,

    1/2 (xi' - free)' M (xi' - free) + sum_c phi_c(J_c x + bias_c) + 1/2 |J_e xi' + bias_e|^2 / eps_e,

where phi_c, whose slope is minus the impulse, is quadratic and grows linearly beyond a bound. Newton's method with a
search along its direction finds that from anywhere, whatever the contacts are.

Source: the fixed point of Tresca's problems, Haslinger (1983); cf. Castro et al., "An unconstrained convex formulation
of compliant contact", T-RO 2023, for the search.
"""

import math

from pinwm_drake.jit import kernel, small_kernel
from pinwm_drake.physics.kernels.cone import (
    FULL_SLIDES,
    FULL_STICKS,
    NN,
    OPEN,
    SLIDES,
    STICKS,
    T11,
    T12,
    T22,
    assemble,
    contact_velocities,
    contact_velocity,
    negative_residual,
    set_gain_across,
    set_slip,
)
from pinwm_drake.physics.kernels.small_matrix import lu_factor, lu_solve

MOST_STEPS = 100
MOST_LOOKS = 60
# Decrement at which the minimum is found, and slope at which a search ends, both relative.
DECREMENT = 1e-22
SLOPE = 1e-2


@small_kernel
def bounded_impulse(system, contacts, work, c, v0, v1, v2):
    """Impulse of contact c at a velocity, with its friction bounded by work.radius[c]."""
    inverse, radius = 1.0 / system.contact_compliance, work.radius[c]
    normal = min(max(-v0 * inverse, 0.0), contacts.limit[c])
    speed = math.sqrt(v1 * v1 + v2 * v2)
    scale = inverse if speed * inverse <= radius else radius / speed
    return normal, -v1 * scale, -v2 * scale


@kernel
def _set_gains(system, contacts, work):
    """Modes, gains and offsets at work.v with friction bounded by work.radius, so that offset - G v is the impulse."""
    inverse = 1.0 / system.contact_compliance
    for c in range(contacts.number[0]):
        v, gain, offset, radius = work.v[c], work.gain[c], work.offset[c], work.radius[c]
        for i in range(6):
            gain[i] = 0.0
        normal, f1, f2 = bounded_impulse(system, contacts, work, c, v[0], v[1], v[2])
        full = normal >= contacts.limit[c]
        gain[NN] = inverse if normal > 0.0 and not full else 0.0
        speed = math.sqrt(v[1] * v[1] + v[2] * v[2])
        sliding = speed * inverse > radius
        if sliding:
            set_slip(work, c, radius)
            set_gain_across(gain, work.slip[c])
        else:
            gain[T11], gain[T22] = inverse, inverse
        offset[0] = normal + gain[NN] * v[0]
        offset[1] = f1 + gain[T11] * v[1] + gain[T12] * v[2]
        offset[2] = f2 + gain[T12] * v[1] + gain[T22] * v[2]
        work.lam[c, 0], work.lam[c, 1], work.lam[c, 2] = normal, f1, f2
        if normal <= 0.0 and radius <= 0.0:
            work.mode[c] = OPEN
        elif full:
            work.mode[c] = FULL_SLIDES if sliding else FULL_STICKS
        else:
            work.mode[c] = SLIDES if sliding else STICKS


@kernel
def _slope(system, contacts, work, constant, linear, share):
    """Return the derivative along work.dx at a share of it; constant and linear are of the quadratic part."""
    total = constant + share * linear
    for c in range(contacts.number[0]):
        v, dv = work.v[c], work.dv[c]
        f0, f1, f2 = bounded_impulse(
            system, contacts, work, c, v[0] + share * dv[0], v[1] + share * dv[1], v[2] + share * dv[2]
        )
        total -= f0 * dv[0] + f1 * dv[1] + f2 * dv[2]
    return total


@kernel
def _quadratic(system, work):
    """Return the derivative along work.dx of the part without contacts, at work.x, and how it grows with the step."""
    x, dx = work.x, work.dx
    size = 6 * system.num_bodies
    constant, linear = 0.0, 0.0
    for b in range(system.num_bodies):
        o = 6 * b
        for i in range(3):
            turn, change = 0.0, 0.0
            for j in range(3):
                turn += system.inertia[b, i, j] * x[o + j]
                change += system.inertia[b, i, j] * dx[o + j]
            constant += dx[o + i] * (turn - system.momentum[o + i])
            linear += dx[o + i] * change
            constant += dx[o + 3 + i] * (system.mass[b] * x[o + 3 + i] - system.momentum[o + 3 + i])
            linear += dx[o + 3 + i] * system.mass[b] * dx[o + 3 + i]
    for r in range(system.num_rows):
        rate, change = system.bias_e[r], 0.0
        for i in range(size):
            rate += system.J_e[r, i] * x[i]
            change += system.J_e[r, i] * dx[i]
        constant += rate * change / system.joint_compliance
        linear += change * change / system.joint_compliance
    return constant, linear


@kernel
def _search(system, contacts, work):
    """Share of work.dx at which the function along it is least, about, and the slope at its start."""
    for c in range(contacts.number[0]):
        work.dv[c, 0], work.dv[c, 1], work.dv[c, 2] = contact_velocity(contacts, c, work.dx)
    constant, linear = _quadratic(system, work)
    first = _slope(system, contacts, work, constant, linear, 0.0)
    low, high = 0.0, 1.0
    at_low, at_high = first, _slope(system, contacts, work, constant, linear, 1.0)
    if at_high <= SLOPE * abs(first):
        return 1.0, first
    share = 0.5
    for look in range(MOST_LOOKS):
        # The secant's zero, and every third time the middle.
        share = 0.5 * (low + high)
        if look % 3 != 2 and at_high > at_low:
            share = low - at_low * (high - low) / (at_high - at_low)
        slope = _slope(system, contacts, work, constant, linear, share)
        if abs(slope) <= SLOPE * abs(first) or high - low < 1e-14:
            break
        if slope > 0.0:
            high, at_high = share, slope
        else:
            low, at_low = share, slope
    return share, first


@kernel
def descend(system, contacts, work, impulse, speed):
    """Move work.x to the minimum for the bounds in work.radius; return the steps taken, or -1 if they ran out."""
    size = 6 * system.num_bodies
    n = size + system.num_rows
    for step in range(MOST_STEPS):
        for r in range(system.num_rows):
            rate = system.bias_e[r]
            for i in range(size):
                rate += system.J_e[r, i] * work.x[i]
            work.x[size + r] = -rate / system.joint_compliance
        contact_velocities(contacts, work.x, work.v)
        _set_gains(system, contacts, work)
        assemble(system, contacts, work)
        if not lu_factor(n, work.S, work.pivot):
            return -1
        negative_residual(system, contacts, work, work.dx)
        lu_solve(n, work.S, work.pivot, work.dx)
        share, slope = _search(system, contacts, work)
        if not -slope > DECREMENT * impulse * speed:
            return step
        for i in range(size):
            work.x[i] += share * work.dx[i]
    return -1
