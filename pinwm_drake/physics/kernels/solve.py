# SPDX-License-Identifier: MIT
"""Solves one step with its contacts: Newton's method, and where that fails a descent that cannot (numba).

The first guess of the position stage is the law of the contacts at the velocities before the step. What a contact bears
is in these, by its compliance, so that a step whose contacts stay as they were is solved at once; and as nothing but
the state is remembered, a step does not depend on those before it. The velocity stage begins with the modes found.
"""

import math

from pinwm_drake.jit import kernel, large_kernel, small_kernel
from pinwm_drake.physics.kernels.cone import (
    FULL_STICKS,
    NO_LIMIT,
    OPEN,
    contact_velocities,
    scales,
    set_mode,
    set_slip,
    slides,
)
from pinwm_drake.physics.kernels.descent import descend
from pinwm_drake.physics.kernels.dynamics import POSITION, VELOCITY
from pinwm_drake.physics.kernels.newton import newton

# Iterations of Newton's method: of the first try, and of those that follow a descent.
FIRST_TRY, MOST_ITERATIONS = 8, 10
# Rounds of the last resort, and the one from which the bounds of friction move by a share only.
ROUNDS, DAMPED, DAMPING = 30, 5, 0.3
# Change of the bounds of friction, relative to the step's impulse, at which they are found.
FOUND = 1e-9


@small_kernel
def _guess(bodies, system, contacts, work, impulse, stage):
    """Start from the velocities before the step, with the modes and bounds of friction that contacts have at them.

    What touches bears what the velocity stage before found, whose law has no gap above 0 and no levers that turn. No
    contact is taken for full: one that closes fast only looks like it.
    """
    size = 6 * system.num_bodies
    for b in range(system.num_bodies):
        for i in range(6):
            work.x[6 * b + i] = bodies.V[b, i]
    for r in range(system.num_rows):
        work.x[size + r] = 0.0
    contact_velocities(contacts, work.x, work.v)
    for c in range(contacts.number[0]):
        touches = stage == POSITION and contacts.closed[c] == 1
        v = work.v[c]
        v0, v1, v2 = v[0], v[1], v[2]
        if touches:
            bent = contacts.curve[c]
            v[0], v[1], v[2] = (
                v0 - max(contacts.gap[c], 0.0) / bodies.time_step[0] - bent[0],
                v1 - bent[1],
                v2 - bent[2],
            )
        set_mode(system, contacts, work, c)
        if work.mode[c] >= FULL_STICKS:
            work.mode[c] -= 2
        # What is beyond the step's scale is a contact that closes, and no force.
        normal = min(max(-work.v[c, 0] / system.contact_compliance, 0.0), contacts.limit[c])
        work.radius[c] = contacts.mu[c] * normal if normal <= impulse else 0.0
        v[0], v[1], v[2] = v0, v1, v2
        if touches and slides(work.mode[c]):
            set_slip(work, c, contacts.mu[c] * normal)


@small_kernel
def _go_on(system, contacts, work):
    """Start from the velocities in work.x, with the modes and impulses of a solution before."""
    for r in range(system.num_rows):
        work.x[6 * system.num_bodies + r] = 0.0
    contact_velocities(contacts, work.x, work.v)
    for c in range(contacts.number[0]):
        work.mode[c] = work.first[c]
        work.radius[c] = contacts.mu[c] * work.lam[c, 0] if work.mode[c] != OPEN else 0.0
        if slides(work.mode[c]) and work.v[c, 1] * work.v[c, 1] + work.v[c, 2] * work.v[c, 2] > 0.0:
            set_slip(work, c, work.radius[c])


@small_kernel
def _is_finite(n, x):
    total = 0.0
    for i in range(n):
        total += abs(x[i])
    return math.isfinite(total)


@kernel
def _rounds(system, contacts, work, impulse, speed):
    """Find bounds of friction and normal forces that agree, from the bounds in work.radius on.

    Every round descends with the bounds of the round before, and then Newton's method is tried from there.

    Returns:
        Iterations used, and whether the solution was found.
    """
    n = 6 * system.num_bodies + system.num_rows
    used = 0
    for i in range(n):
        work.x[i] = system.free[i] if i < 6 * system.num_bodies else 0.0
    for round_ in range(ROUNDS):
        steps = descend(system, contacts, work, impulse, speed)
        used += steps if steps >= 0 else MOST_ITERATIONS
        if not _is_finite(n, work.x):
            return used, False
        change = 0.0
        for c in range(contacts.number[0]):
            wanted = contacts.mu[c] * work.lam[c, 0]
            change = max(change, abs(wanted - work.radius[c]))
            work.radius[c] = wanted if round_ < DAMPED else work.radius[c] + DAMPING * (wanted - work.radius[c])
        if change <= FOUND * impulse:
            return used, True
        if round_ == ROUNDS - 1:
            break
        for i in range(n):
            work.kept[i] = work.x[i]
        for c in range(contacts.number[0]):
            set_mode(system, contacts, work, c)
        more = newton(system, contacts, work, impulse, speed, MOST_ITERATIONS)
        used += more if more >= 0 else MOST_ITERATIONS
        if more >= 0 and _is_finite(n, work.x):
            return used, True
        for i in range(n):
            work.x[i] = work.kept[i]
    return used, False


@large_kernel
def _last_resort(system, contacts, work, impulse, speed):
    """`solve_contacts` where Newton's method did not suffice."""
    n = 6 * system.num_bodies + system.num_rows
    used = 0
    for attempt in range(2):
        if attempt == 1:
            for c in range(contacts.number[0]):
                work.radius[c] = NO_LIMIT
        more, found = _rounds(system, contacts, work, impulse, speed)
        used += more
        if found:
            return used
        if not _is_finite(n, work.x):
            return -1
    work.lagged[0] = 1
    return used


@small_kernel
def solve_contacts(bodies, system, contacts, work, stage):
    """Leaves the solution of a stage in work.x, its velocities, impulses and modes in work.v, work.lam and work.mode.

    The last resort takes the bounds of friction from the round before: first from those at the velocities before the
    step, and where they do not settle from contacts that all stick. A body that wedges itself has no solution near the
    first, but one near the second: it jams. Where neither settles, the solution of the last round is taken: its
    friction opposes sliding and does no work, but its bound is that of another normal force. Such a step is marked in
    work.lagged.

    Returns:
        Iterations used, or -1 where a number is not finite.
    """
    n = 6 * system.num_bodies + system.num_rows
    impulse, speed = scales(system, contacts)
    work.lagged[0] = 0
    if stage == VELOCITY:
        _go_on(system, contacts, work)
    else:
        _guess(bodies, system, contacts, work, impulse, stage)
    used = newton(system, contacts, work, impulse, speed, FIRST_TRY)
    if used >= 0:
        return used if _is_finite(n, work.x) else -1
    used = _last_resort(system, contacts, work, impulse, speed)
    return FIRST_TRY + used if used >= 0 else -1


@large_kernel
def solve_again(bodies, system, contacts, work, stage):
    """`solve_contacts`, where it is not needed at every step."""
    return solve_contacts(bodies, system, contacts, work, stage)
