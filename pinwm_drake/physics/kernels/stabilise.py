"""Removes penetration and joint drift by moving positions only, so that no velocity and no energy is added (numba).

The correction delta = [rotation; translation] of all bodies minimises

    1/2 kappa delta' W delta + 1/2 sum_c w_c (J_n,c delta - depth_c)^2 + 1/2 sum_r (J_e,r delta + error_r)^2,

with the contacts of the step, depth = max(-gap - SLOP, 0), and weights w that fade in as a contact nears the
surface so that delta depends continuously on the pose. Penetration down to SLOP is left to the LCP, whose contact
rows pull the gap to zero from both sides: a resting contact then has the derivative of a contact, not a kink, and
the velocity it can gain, SLOP / h, holds less energy than lifting the body by SLOP. Penetration deeper than that
is rare, because the LCP lets no contact close by more than its gap.

Source: in place of the Baumgarte term of PIN-WM eq. 9; cf. Cline (2002), section 4.5 (post-stabilisation).
"""

from pinwm_drake.jit import kernel
from pinwm_drake.physics.kernels.cone import FULL_STICKS
from pinwm_drake.physics.kernels.small_matrix import lu_factor, lu_solve

# Penetration that the step itself removes, m.
SLOP = 1e-6
# A contact farther apart than this has no part in the correction, m.
FADE_GAP = 1e-4
# Ratio of the metric's weight to a contact's.
KAPPA = 1e-6
# Depth by which a body comes out of the pusher in a step, m, and an impulse that no contact with a limit has, N s.
MOST_PUSHED = 1e-4
UNLIMITED = 1e290


@kernel
def contact_weight(gap):
    """Weight of a contact with this gap, and its derivative: a C1 ramp from 1 at the surface to 0 at FADE_GAP."""
    if gap <= 0.0:
        return 1.0, 0.0
    if gap >= FADE_GAP:
        return 0.0, 0.0
    t = 1.0 - gap / FADE_GAP
    return t * t * (3.0 - 2.0 * t), -6.0 * t * (1.0 - t) / FADE_GAP


@kernel
def wanted(contacts, solver, c):
    """Depth that the correction takes from contact c, and its derivative with respect to the penetration.

    What the pusher could not hold it may be in, and it comes out slowly.
    """
    depth = -contacts.gap[c] - SLOP
    if depth <= 0.0 or solver.mode[c] >= FULL_STICKS:
        return 0.0, 0.0
    if contacts.limit[c] < UNLIMITED and depth > MOST_PUSHED:
        return MOST_PUSHED, 0.0
    return depth, 1.0


@kernel
def factor_stabilisation(model, contacts, system, solver):
    """Assembles and factors the normal equations in solver.S_delta, their right-hand side in solver.delta.

    Returns:
        False if there is nothing to correct (or the matrix is singular).
    """
    needed = system.num_rows > 0
    for c in range(contacts.number[0]):
        if wanted(contacts, solver, c)[0] > 0.0:
            needed = True
    if not needed:
        return False
    size = 6 * system.num_bodies
    S, delta = solver.S_delta, solver.delta
    for i in range(size):
        delta[i] = 0.0
        for j in range(size):
            S[i, j] = 0.0
    for b in range(system.num_bodies):
        for i in range(3):
            S[6 * b + i, 6 * b + i] = KAPPA * model.stabilisation_weight[b, 0]
            S[6 * b + 3 + i, 6 * b + 3 + i] = KAPPA * model.stabilisation_weight[b, 1]
    for c in range(contacts.number[0]):
        weight, _ = contact_weight(contacts.gap[c])
        if weight == 0.0 or solver.mode[c] >= FULL_STICKS:
            continue
        depth, _ = wanted(contacts, solver, c)
        for left in range(2):
            row = contacts.dynamic[c, left]
            if row < 0:
                continue
            for i in range(6):
                Ji = weight * contacts.J[c, left, 0, i]
                delta[6 * row + i] += Ji * depth
                for right in range(2):
                    column = contacts.dynamic[c, right]
                    if column >= 0:
                        for j in range(6):
                            S[6 * row + i, 6 * column + j] += Ji * contacts.J[c, right, 0, j]
    for r in range(system.num_rows):
        for i in range(size):
            Ji = system.J_e[r, i]
            if Ji != 0.0:
                delta[i] -= Ji * system.error_e[r]
                for j in range(size):
                    S[i, j] += Ji * system.J_e[r, j]
    return lu_factor(size, S, solver.pivot_delta)


@kernel
def stabilise(model, contacts, system, solver):
    """Leaves the correction in solver.delta (6 num_bodies); returns False if it is zero."""
    if not factor_stabilisation(model, contacts, system, solver):
        return False
    lu_solve(6 * system.num_bodies, solver.S_delta, solver.pivot_delta, solver.delta)
    return True
