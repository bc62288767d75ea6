# SPDX-License-Identifier: MIT
"""Newton's method for a step with its contacts, on their modes and directions of sliding (numba).

In fixed modes, and with fixed directions of sliding, a step is one linear system; its solution tells which modes were
wrong and how directions turn. A sliding contact is decided by lambda_t - rho s_t, as the cone's projection has it, and
not by its velocity alone: a body whose sliding reverses within the step then sticks, instead of turning back and forth.

Source: Alart and Curnier, "A mixed formulation for frictional contact problems prone to Newton like solution methods",
Comput. Methods Appl. Mech. Eng. 92, 1991; Hintermüller, Ito, Kunisch, SIAM J. Optim. 13(3), 2002.
"""

import math

from pinwm_drake.jit import kernel, small_kernel
from pinwm_drake.physics.kernels.cone import (
    ACROSS,
    ALONG_1,
    ALONG_2,
    FULL_STICKS,
    OPEN,
    SLIDES,
    STICKS,
    assemble,
    contact_velocities,
    negative_residual,
    set_gain,
    set_slip,
    slides,
    take_impulses,
)
from pinwm_drake.physics.kernels.small_matrix import lu_factor, lu_solve

# A violated inequality below this, relative to the step's impulse and speed scales, is rounding.
TOLERANCE = 1e-12
# Modes that are wrong at once, after the first two iterations, from which they only change about.
MANY = 3
# Directions that turn by less than this, rad, converge with more steps on the same factors; and a turn, and a step
# relative to the step's speed, that need no other. Factors stay while steps shrink the turn by the ratio.
SMALL_TURN, NO_TURN, SMALL_STEP, SMALL_RATIO = 3e-3, 1e-12, 1e-3, 1e-2


@small_kernel
def _resistance(system, contacts, c):
    """Mass that contact c feels along its surface, about, kg: the scale rho of its impulses over its speeds."""
    inverse = 0.0
    for side in range(2):
        b = contacts.dynamic[c, side]
        if b >= 0:
            r, inertia = contacts.lever[c, side], system.inertia[b]
            inverse += 1.0 / system.mass[b]
            arm = r[0] * r[0] + r[1] * r[1] + r[2] * r[2]
            inverse += 3.0 * arm / (inertia[0, 0] + inertia[1, 1] + inertia[2, 2])
    return 1.0 / inverse


@small_kernel
def _close(contacts, work, c):
    """Close contact c: it slides where its friction would not stop it while its normal impulse stops the approach."""
    v, mu = work.v[c], contacts.mu[c]
    speed = math.sqrt(v[1] * v[1] + v[2] * v[2])
    if speed <= -mu * v[0]:
        work.mode[c] = STICKS
        return
    work.mode[c] = SLIDES
    set_slip(work, c, -work.rho[c] * mu * v[0])


@small_kernel
def _correct_normal(system, contacts, work, c, impulse, speed):
    """Corrects whether contact c is open, closed or full; 1 where it was wrong."""
    mode, v, lam = work.mode[c], work.v[c], work.lam[c]
    if mode == OPEN:
        if v[0] < -TOLERANCE * speed:
            _close(contacts, work, c)
            return 1
        return 0
    if mode >= FULL_STICKS:
        if -v[0] / system.contact_compliance < contacts.limit[c] - TOLERANCE * impulse:
            work.mode[c] = mode - 2
            return 1
        return 0
    if lam[0] < -TOLERANCE * impulse:
        work.mode[c] = OPEN
        return 1
    if lam[0] > contacts.limit[c] + TOLERANCE * impulse:
        work.mode[c] = mode + 2
        return 1
    return 0


@small_kernel
def _correct_friction(system, contacts, work, c, impulse):
    """Corrects whether contact c slides, and where to; returns 1 where the mode was wrong, and the turn, rad."""
    v, lam, slip = work.v[c], work.lam[c], work.slip[c]
    most, eps = contacts.mu[c] * max(lam[0], 0.0), system.contact_compliance
    sliding = slides(work.mode[c])
    if not sliding:
        size = math.sqrt(lam[1] * lam[1] + lam[2] * lam[2])
        if size <= most + TOLERANCE * impulse:
            return 0, 0.0
    rho = work.rho[c]
    w1, w2 = lam[1] - rho * (v[1] + eps * lam[1]), lam[2] - rho * (v[2] + eps * lam[2])
    size = math.sqrt(w1 * w1 + w2 * w2)
    if sliding and size < most - TOLERANCE * impulse:
        work.mode[c] -= 1
        return 1, 0.0
    if size == 0.0:
        return 0, 0.0
    turn = abs(slip[ALONG_1] * w2 - slip[ALONG_2] * w1) / size
    if slip[ALONG_1] * w1 + slip[ALONG_2] * w2 < 0.0:
        turn = 1.0
    ratio = min(most / size, 1.0)
    slip[ALONG_1], slip[ALONG_2] = w1 / size, w2 / size
    slip[ACROSS] = rho * ratio / ((1.0 - ratio) + ratio * rho * eps)
    if sliding:
        return 0, turn
    work.mode[c] += 1
    return 1, 0.0


@small_kernel
def _correct(system, contacts, work, impulse, speed):
    """Corrects all modes and directions; returns how many modes were wrong, and the largest turn, rad."""
    wrong, most = 0, 0.0
    for c in range(contacts.number[0]):
        was_open = work.mode[c] == OPEN
        wrong += _correct_normal(system, contacts, work, c, impulse, speed)
        if was_open or work.mode[c] == OPEN or contacts.mu[c] == 0.0:
            continue
        flipped, turn = _correct_friction(system, contacts, work, c, impulse)
        wrong += flipped
        most = max(most, turn)
    return wrong, most


@small_kernel
def _step(system, contacts, work):
    """Add the solution of the factored system to work.x; its velocities and impulses follow.

    Returns:
        Largest change of an entry of x.
    """
    n = 6 * system.num_bodies + system.num_rows
    negative_residual(system, contacts, work, work.dx)
    lu_solve(n, work.S, work.pivot, work.dx)
    largest = 0.0
    for i in range(n):
        work.x[i] += work.dx[i]
        largest = max(largest, abs(work.dx[i]))
    contact_velocities(contacts, work.x, work.v)
    take_impulses(contacts, work)
    return largest


@small_kernel
def factor(system, contacts, work):
    """Factors the derivative of a step's equations for the gains of its contacts; False if it is singular."""
    assemble(system, contacts, work)
    return lu_factor(6 * system.num_bodies + system.num_rows, work.S, work.pivot)


@small_kernel
def newton(system, contacts, work, impulse, speed, iterations):
    """Solves a step from work.x, its velocities work.v and the modes in work.mode, which it corrects.

    Returns:
        Iterations used, or -1 if they did not suffice; work.v and work.lam are those of work.x.
    """
    for c in range(contacts.number[0]):
        work.rho[c] = _resistance(system, contacts, c)
    fresh, last, before = True, False, 0.0
    for iteration in range(iterations + 1):
        for c in range(contacts.number[0]):
            set_gain(system, contacts, work, c)
        if fresh and not factor(system, contacts, work):
            return -1
        change = _step(system, contacts, work)
        if last and change <= SMALL_STEP * speed:
            return iteration
        if iteration == iterations:
            return -1
        wrong, turn = _correct(system, contacts, work, impulse, speed)
        if iteration > 1 and wrong >= MANY:
            return -1
        if wrong == 0 and turn <= NO_TURN and change <= SMALL_STEP * speed:
            return iteration + 1
        # By how much a step on the same factors makes the turn smaller: by about the first one.
        ratio = turn if fresh else turn / before
        fresh, before = wrong > 0 or turn > SMALL_TURN or ratio > SMALL_RATIO, max(turn, NO_TURN)
        last = not fresh and turn * ratio <= NO_TURN
    return -1


@kernel
def recall_solution(system, contacts, work):
    """Brings all of a solution up to date with its velocities in work.x and its modes in work.mode.

    Returns:
        False if the factored derivative of the step's equations is singular.
    """
    contact_velocities(contacts, work.x, work.v)
    for c in range(contacts.number[0]):
        if slides(work.mode[c]):
            normal = min(max(-work.v[c, 0] / system.contact_compliance, 0.0), contacts.limit[c])
            set_slip(work, c, contacts.mu[c] * normal)
        set_gain(system, contacts, work, c)
    if not factor(system, contacts, work):
        return False
    if system.num_rows > 0:
        # The impulses of joints, which are kept nowhere.
        for r in range(system.num_rows):
            work.x[6 * system.num_bodies + r] = 0.0
        _step(system, contacts, work)
    take_impulses(contacts, work)
    return True
