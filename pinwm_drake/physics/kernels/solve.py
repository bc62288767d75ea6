"""Solves one step's LCP: the last active set first, then the interior-point method, then Lemke's (numba)."""

from pinwm_drake.jit import kernel
from pinwm_drake.physics.kernels.active_set import correct_active_set, solve_active_set
from pinwm_drake.physics.kernels.interior_point import interior_point, scales, start_point
from pinwm_drake.physics.kernels.lemke import solve_by_lemke

# A violated sign below this, relative to the step's impulse and speed scales, is rounding.
SIGN_TOLERANCE = 1e-12
# How often a wrong set is corrected by its signs before the interior-point method takes over.
MAX_CORRECTIONS = 8
# Relative duality gaps at which the interior-point method offers its active set; the last one hands over to Lemke's.
GAPS = (1e-6, 1e-9, 1e-12)
MAX_ITERATIONS = 60
# Last resorts: violated signs below the first are taken for rounding, and Lemke's vector is perturbed by the second.
# With many points on one face many sets are nearly right, and rounding decides which signs they have.
RESORTS = ((1e-12, 1e-10), (1e-10, 1e-9), (1e-9, 1e-8), (1e-8, 1e-7), (1e-7, 1e-7), (1e-6, 1e-6))


@kernel
def _settle(system, contacts, work, impulse, speed, tolerance):
    """Solves on work.active, correcting it by its signs; True if all inequalities hold to a relative tolerance."""
    for _ in range(MAX_CORRECTIONS):
        if not solve_active_set(system, contacts, work, work.active, work.x, work.lam, work.s):
            return False
        flips = correct_active_set(
            system, contacts, work.active, work.lam, work.s, tolerance * impulse, tolerance * speed
        )
        if flips == 0:
            return True
    return False


@kernel
def _offer(system, contacts, work, impulse, speed, gap):
    """Leaves the active set of an interior point of a relative gap in work.active; returns the iterations."""
    k = len(system.cosines)
    start_point(system, contacts, work.x, work.lam, work.s, impulse, speed)
    steps = interior_point(system, contacts, work, work.x, work.lam, work.s, impulse, speed, gap, MAX_ITERATIONS)
    for c in range(contacts.number[0]):
        for i in range(k + 1):
            work.active[c, i] = 1 if work.lam[c, i] * speed > work.s[c, i] * impulse else 0
        work.active[c, k + 1] = 1 if work.lam[c, k + 1] * impulse > work.s[c, k + 1] * speed else 0
        if contacts.mu[c] == 0.0:
            for i in range(1, k + 2):
                work.active[c, i] = 0
    return steps if steps >= 0 else MAX_ITERATIONS


@kernel
def solve_lcp(system, contacts, work, warm):
    """Solves the LCP to rounding; leaves the solution in work.x, work.lam, work.s and its set in work.active.

    Args:
        warm: whether work.active holds a guess. It changes the time taken, not the solution.

    Returns:
        Interior-point iterations used (0 if the guess was right), or -1 if no solution was found.
    """
    k = len(system.cosines)
    nc = contacts.number[0]
    impulse, speed = scales(system, contacts)
    if (warm or nc == 0) and _settle(system, contacts, work, impulse, speed, SIGN_TOLERANCE):
        return 0
    if nc == 0:
        return -1
    used = 0
    for stage in range(len(GAPS)):
        # Settling overwrote the iterate: begin again and go further. It is rare, so simplicity wins.
        used += _offer(system, contacts, work, impulse, speed, GAPS[stage])
        if _settle(system, contacts, work, impulse, speed, SIGN_TOLERANCE):
            return used
    for resort in range(len(RESORTS)):
        tolerance, perturbation = RESORTS[resort]
        if resort > 0:
            used += _offer(system, contacts, work, impulse, speed, GAPS[-1])
            if _settle(system, contacts, work, impulse, speed, tolerance):
                return used + 1000
        if solve_by_lemke(system, contacts, work, impulse, speed, perturbation) and _settle(
            system, contacts, work, impulse, speed, tolerance
        ):
            return used
    return -1
