"""Solves the LCP on a guessed active set and corrects the guess (numba).

On the right active set the LCP is one linear system, solved here to rounding. A guess that fails its inequalities
is corrected from their signs (a semi-smooth Newton iteration) a few times; the interior-point method is what
makes the whole global. In a rollout the previous step's set is nearly always right.

Source: Hintermüller, Ito, Kunisch, "The primal-dual active set strategy as a semismooth Newton method", SIAM J.
Optim. 13(3), 2002.
"""

from pinwm_drake.jit import kernel
from pinwm_drake.physics.kernels.lcp import (
    assemble,
    contact_loads,
    negative_residual,
    recover,
    reduce_contact,
    slacks,
)
from pinwm_drake.physics.kernels.small_matrix import lu_factor, lu_solve


@kernel
def factor_active_set(system, contacts, work, active):
    """Reduces, assembles and factors the linear system of an active set; False if it is singular.

    Args:
        system: SystemWork.
        contacts: ContactWork.
        work: SolverWork; its `weights`, `reduced`, `S` and `pivot` are overwritten.
        active: (>=nc, k + 2) uint8, 1 where lambda (or gamma) may be positive and its slack is zero; a normal of 2 has
            its largest impulse, and any slack.
    """
    k = len(system.cosines)
    nc = contacts.number[0]
    inverse = 1.0 / system.contact_compliance
    for c in range(nc):
        held = active[c, 0] != 0
        for i in range(k):
            work.weights[c, i] = inverse if held and active[c, 1 + i] != 0 else 0.0
        reduce_contact(system, work, c, inverse if active[c, 0] == 1 else 0.0, 0.0, active[c, k + 1] == 0)
    assemble(system, contacts, work)
    return lu_factor(6 * system.num_bodies + system.num_rows, work.S, work.pivot)


@kernel
def solve_active_set(system, contacts, work, active, x, lam, s):
    """Solves the linear system of an active set from scratch, with one step of iterative refinement.

    Writes x = [xi'; lambda_e], lam and the slacks s of all rows. Returns False if the matrix is singular.
    """
    k = len(system.cosines)
    nc = contacts.number[0]
    n = 6 * system.num_bodies + system.num_rows
    if not factor_active_set(system, contacts, work, active):
        return False
    for i in range(n):
        x[i] = 0.0
    for c in range(nc):
        for i in range(k + 2):
            lam[c, i] = 0.0
        if active[c, 0] == 2:
            lam[c, 0] = contacts.limit[c]
    for _ in range(2):
        slacks(system, contacts, x, lam, s)
        for c in range(nc):
            for i in range(k + 2):
                work.R[c, i] = -s[c, i]
        negative_residual(system, contacts, x, lam, work.dx)
        contact_loads(system, contacts, work, work.dx)
        lu_solve(n, work.S, work.pivot, work.dx)
        recover(system, contacts, work, work.dx, work.dlam)
        for i in range(n):
            x[i] += work.dx[i]
        for c in range(nc):
            for i in range(k + 2):
                lam[c, i] += work.dlam[c, i]
    slacks(system, contacts, x, lam, s)
    return True


@kernel
def correct_active_set(system, contacts, active, lam, s, impulse_tolerance, speed_tolerance):
    """Flips the rows of `active` whose inequality fails; returns how many were flipped.

    Args:
        impulse_tolerance: a multiplier above minus this counts as non-negative, N s.
        speed_tolerance: a slack above minus this counts as non-negative, m/s.
    """
    k = len(system.cosines)
    flips = 0
    for c in range(contacts.number[0]):
        if active[c, 0] == 0:
            if s[c, 0] < -speed_tolerance:
                # A contact that closes starts out sticking: the directions that oppose its velocity carry load.
                flips += 1
                active[c, 0] = 1
                active[c, k + 1] = 0
                g = lam[c, k + 1]
                for i in range(k):
                    active[c, 1 + i] = 1 if s[c, 1 + i] - g < 0.0 and contacts.mu[c] > 0.0 else 0
            continue
        if active[c, 0] == 2:
            if s[c, 0] > speed_tolerance:
                flips += 1
                active[c, 0] = 1
        elif lam[c, 0] < -impulse_tolerance:
            flips += 1
            active[c, 0] = 0
            continue
        elif lam[c, 0] > contacts.limit[c] + impulse_tolerance:
            flips += 1
            active[c, 0] = 2
        if contacts.mu[c] == 0.0:
            continue
        for i in range(k):
            if active[c, 1 + i] != 0:
                if lam[c, 1 + i] < -impulse_tolerance:
                    flips += 1
                    active[c, 1 + i] = 0
            elif s[c, 1 + i] < -speed_tolerance:
                flips += 1
                active[c, 1 + i] = 1
        if active[c, k + 1] != 0:
            if lam[c, k + 1] < -speed_tolerance:
                flips += 1
                active[c, k + 1] = 0
        elif s[c, k + 1] < -impulse_tolerance:
            flips += 1
            active[c, k + 1] = 1
    return flips
