"""Primal-dual interior-point method for the step's LCP (numba).

Mehrotra's predictor-corrector on s = A z + q, s z = tau: the predictor aims at tau = 0, its step length sets the
centring (gap_aff / gap)^3, the corrector adds the second-order term, and one factor serves both. Steps keep
multipliers and slacks positive with one common length, because the rows couple them.

Source: Mehrotra (1992); Nocedal and Wright, Numerical Optimization, algorithm 14.3; Mattingley and Boyd (2012) for
the form that OptNet and PIN-WM's released code use.
"""

from pinwm_drake.jit import kernel
from pinwm_drake.physics.kernels.lcp import (
    assemble,
    contact_loads,
    contact_velocity,
    negative_residual,
    recover,
    reduce_contact,
    slacks,
)
from pinwm_drake.physics.kernels.small_matrix import lu_factor, lu_solve

# A step shorter than this is followed by one that centres, towards this part of the gap.
SHORT_STEP = 0.3
CENTRING = 0.5


@kernel
def scales(system, contacts):
    """Impulse [N s] and speed [m/s] scales of a step, by which tolerances are made relative."""
    speed = 1e-6
    total = 0.0
    for b in range(system.num_bodies):
        total += system.mass[b]
        for i in range(3):
            speed = max(speed, abs(system.free[6 * b + 3 + i]))
    for c in range(contacts.number[0]):
        jn, j1, j2 = contact_velocity(contacts, c, system.free)
        for i in range(3):
            speed = max(speed, abs(contacts.bias[c, i]))
        speed = max(speed, max(abs(jn), max(abs(j1), abs(j2))))
    return total * speed / max(contacts.number[0], 1), speed


@kernel
def start_point(system, contacts, x, lam, s, impulse, speed):
    """A well-centred positive start: the free velocity, and multipliers and slacks of the step's scales."""
    k = len(system.cosines)
    for i in range(6 * system.num_bodies):
        x[i] = system.free[i]
    for r in range(system.num_rows):
        x[6 * system.num_bodies + r] = 0.0
    for c in range(contacts.number[0]):
        mu = contacts.mu[c]
        lam[c, 0] = impulse
        s[c, 0] = speed
        lam[c, k + 1] = speed
        s[c, k + 1] = 0.5 * mu * impulse
        for i in range(k):
            lam[c, 1 + i] = 0.5 * mu * impulse / k
            s[c, 1 + i] = speed
        if mu == 0.0:
            # Such a contact has its normal row only.
            for i in range(1, k + 2):
                lam[c, i] = 0.0


@kernel
def _direction(system, contacts, work, x, lam):
    """Solves the Newton system for the right-hand side in work.R into work.dx and work.dlam."""
    n = 6 * system.num_bodies + system.num_rows
    negative_residual(system, contacts, x, lam, work.dx)
    contact_loads(system, contacts, work, work.dx)
    lu_solve(n, work.S, work.pivot, work.dx)
    recover(system, contacts, work, work.dx, work.dlam)


@kernel
def interior_point(system, contacts, work, x, lam, s, impulse, speed, tolerance, max_iterations):
    """Follows the central path from (x, lam, s) until gap and residuals are below `tolerance`, relative.

    Args:
        impulse, speed: the scales of `scales`.
        tolerance: bound on the mean of lambda s over (impulse speed), and on row residuals over their scale.
        max_iterations: Newton iterations at the most.

    Returns:
        Iterations used, or -1 if the Newton matrix became singular or the steps vanished.
    """
    k = len(system.cosines)
    nc = contacts.number[0]
    n = 6 * system.num_bodies + system.num_rows
    eps = system.contact_compliance
    gap_scale = impulse * speed
    num_rows = 0
    for c in range(nc):
        num_rows += k + 2 if contacts.mu[c] > 0.0 else 1
    alpha = 1.0
    for iteration in range(max_iterations):
        slacks(system, contacts, x, lam, work.r)
        gap, residual = 0.0, 0.0
        for c in range(nc):
            for i in range(k + 2 if contacts.mu[c] > 0.0 else 1):
                work.r[c, i] -= s[c, i]
                gap += lam[c, i] * s[c, i]
                residual = max(residual, abs(work.r[c, i]) / (speed if i <= k else impulse))
        gap /= num_rows
        if gap <= tolerance * gap_scale and residual <= tolerance:
            return iteration
        for c in range(nc):
            rough = contacts.mu[c] > 0.0
            for i in range(k):
                work.weights[c, i] = lam[c, 1 + i] / (s[c, 1 + i] + eps * lam[c, 1 + i]) if rough else 0.0
            for i in range(k + 2 if contacts.mu[c] > 0.0 else 1):
                work.R[c, i] = -work.r[c, i] - s[c, i]
            inv_dn = lam[c, 0] / (s[c, 0] + eps * lam[c, 0])
            reduce_contact(system, work, c, inv_dn, s[c, k + 1] / lam[c, k + 1] if rough else 0.0, not rough)
        assemble(system, contacts, work)
        if not lu_factor(n, work.S, work.pivot):
            return -1
        _direction(system, contacts, work, x, lam)
        previous = alpha
        longest = 1.0
        for c in range(nc):
            for i in range(k + 2 if contacts.mu[c] > 0.0 else 1):
                ratio = work.dlam[c, i] / lam[c, i]
                work.ratio[c, i] = ratio
                longest = max(longest, max(-ratio, 1.0 + ratio))
        alpha = 1.0 / longest
        gap_affine = 0.0
        for c in range(nc):
            for i in range(k + 2 if contacts.mu[c] > 0.0 else 1):
                ratio = work.ratio[c, i]
                gap_affine += lam[c, i] * (1.0 + alpha * ratio) * s[c, i] * (1.0 - alpha * (1.0 + ratio))
        gap_affine /= num_rows
        relative = gap_affine / gap
        target = relative * relative * relative * gap
        # A short step means that some products lag far behind the mean: the next one only restores the balance.
        second_order = 1.0
        if previous < SHORT_STEP:
            target, second_order = CENTRING * gap, 0.0
        for c in range(nc):
            for i in range(k + 2 if contacts.mu[c] > 0.0 else 1):
                ratio = work.ratio[c, i]
                work.R[c, i] = (
                    -work.r[c, i] + target / lam[c, i] - s[c, i] * (1.0 - second_order * ratio * (1.0 + ratio))
                )
        _direction(system, contacts, work, x, lam)
        longest = 1e-3
        for c in range(nc):
            for i in range(k + 2 if contacts.mu[c] > 0.0 else 1):
                ratio = work.dlam[c, i] / lam[c, i]
                # ds / s from lambda ds + s dlambda = target - lambda s - (dlambda ds)_affine
                q = (work.R[c, i] + work.r[c, i]) / s[c, i]
                longest = max(longest, max(-ratio, ratio - q))
        alpha = min(1.0, max(0.99, 1.0 - relative) / longest)
        if not alpha > 1e-12:
            return -1
        for i in range(n):
            x[i] += alpha * work.dx[i]
        for c in range(nc):
            for i in range(k + 2 if contacts.mu[c] > 0.0 else 1):
                d = work.dlam[c, i]
                ds = (work.R[c, i] + work.r[c, i]) - s[c, i] * d / lam[c, i]
                lam[c, i] += alpha * d
                s[c, i] += alpha * ds
    return max_iterations
