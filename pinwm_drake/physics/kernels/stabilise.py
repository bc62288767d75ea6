# SPDX-License-Identifier: MIT
"""Removes penetration and joint drift by moving positions only, so that no velocity and no energy is added (numba).

The correction delta = [rotation; translation] of all bodies minimises

    1/2 kappa delta' W delta + 1/2 w sum_c max(depth_c - J_n,c delta, 0)^2 + 1/2 sum_r (J_e,r delta + error_r)^2

with the contacts of the step and depth = -gap - SLOP: what is deeper comes out, and what is not may move as far as it
is away. The weight w of a contact is small enough against the metric that contacts close together, differently deep,
do not turn a body about themselves. Penetration down to SLOP is left to the step's equations, which pull the gap to
zero from both sides: a resting contact then has the derivative of a contact, not a kink, and the velocity it can gain,
SLOP / h, holds less energy than lifting the body by SLOP. Penetration deeper than that is rare, because no contact
closes by more than its gap.

Source: in place of the Baumgarte term of PIN-WM eq. 9; cf. Cline (2002), section 4.5 (post-stabilisation).
"""

from pinwm_drake.jit import kernel, small_kernel
from pinwm_drake.physics.kernels.cone import FULL_STICKS, NO_LIMIT
from pinwm_drake.physics.kernels.small_matrix import lu_factor, lu_solve

# Penetration that the step itself removes, m.
SLOP = 1e-6
# Weights of the metric and of a contact, relative to that of a joint.
KAPPA, CONTACT = 1e-6, 1e-4
# Rounds in which it is found which contacts push, and a distance that is rounding, m.
ROUNDS, ROUNDING = 10, 1e-12
# Depth by which a body comes out of the pusher in a step, m.
MOST_PUSHED = 1e-4


@small_kernel
def wanted(contacts, c):
    """Distance by which contact c is to come out, m (negative: may move in), and its derivative by the penetration.

    What the pusher could not hold it may be in, and it comes out slowly.
    """
    depth = -contacts.gap[c] - SLOP
    if contacts.limit[c] < NO_LIMIT and depth > MOST_PUSHED:
        return MOST_PUSHED, 0.0
    return depth, 1.0


@kernel
def _assemble(model, contacts, system, solver):
    """Write the normal equations of the contacts that push into solver.S_delta and solver.delta."""
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
        if solver.lifts[c] == 0:
            continue
        depth, _ = wanted(contacts, c)
        for left in range(2):
            row = contacts.dynamic[c, left]
            if row < 0:
                continue
            for i in range(6):
                Ji = CONTACT * contacts.J[c, left, 0, i]
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


@small_kernel
def stabilise(model, contacts, system, solver):
    """Leaves the correction in solver.delta (6 num_bodies), its factors, and what pushes in solver.lifts.

    Returns:
        False if there is nothing to correct (or the matrix is singular).
    """
    needed = system.num_rows > 0
    for c in range(contacts.number[0]):
        lifts = solver.mode[c] < FULL_STICKS and wanted(contacts, c)[0] > 0.0
        solver.lifts[c] = 1 if lifts else 0
        needed = needed or lifts
    if not needed:
        return False
    size = 6 * system.num_bodies
    for round_ in range(ROUNDS):
        _assemble(model, contacts, system, solver)
        if not lu_factor(size, solver.S_delta, solver.pivot_delta):
            return False
        lu_solve(size, solver.S_delta, solver.pivot_delta, solver.delta)
        wrong = False
        for c in range(contacts.number[0]):
            if solver.mode[c] >= FULL_STICKS or round_ == ROUNDS - 1:
                continue
            left, _ = wanted(contacts, c)
            for side in range(2):
                body = contacts.dynamic[c, side]
                if body >= 0:
                    for i in range(6):
                        left -= contacts.J[c, side, 0, i] * solver.delta[6 * body + i]
            lifts = 1 if left > (-ROUNDING if solver.lifts[c] == 1 else ROUNDING) else 0
            if lifts != solver.lifts[c]:
                solver.lifts[c], wrong = lifts, True
        if not wrong:
            break
    return True
