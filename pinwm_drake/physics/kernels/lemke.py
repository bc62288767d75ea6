"""Lemke's method on the step's LCP with the bodies eliminated: slow, dense, and sure (numba).

The friction LCP is copositive, so Lemke's method ends at a solution where an interior-point method, which presumes
monotonicity, may stall (stuck contacts with friction of 1 and more). It is tried last.

Source: Cottle, Pang, Stone, The Linear Complementarity Problem, algorithm 4.4.5; against cycling a perturbation of
the vector, section 4.9.
"""

import numpy as np

from pinwm_drake.jit import allocating_kernel
from pinwm_drake.physics.kernels.lcp import assemble
from pinwm_drake.physics.kernels.small_matrix import lu_factor, lu_solve

# A pivot smaller than this, in scaled variables, is a rounded zero.
_PIVOT = 1e-11
# Pivots for each unknown at the most. A solution takes one or two; each costs as much as there are entries.
_PIVOTS = 5


@allocating_kernel
def standard_form(system, contacts, work, impulse, speed, rows, matrix, vector):
    """Writes the scaled LCP s = matrix z + vector of the listed rows.

    Args:
        impulse, speed: scales of multipliers and slacks (of normal and friction rows; swapped for gamma rows).
        rows: (N, 2), contact and row of each unknown.
        matrix: (N, N), vector: (N,), receive the LCP in units of the scales.

    Returns:
        False if the bodies' matrix is singular.
    """
    k = len(system.cosines)
    size = 6 * system.num_bodies
    n = size + system.num_rows
    N = rows.shape[0]
    for c in range(contacts.number[0]):
        for i in range(8):
            work.reduced[c, i] = 0.0
    assemble(system, contacts, work)
    if not lu_factor(n, work.S, work.pivot):
        return False
    H = np.zeros((N + 1, n))
    for r in range(N):
        c, i = rows[r, 0], rows[r, 1]
        for side in range(2):
            body = contacts.dynamic[c, side]
            if body >= 0 and i <= k:
                for j in range(6):
                    if i == 0:
                        H[r, 6 * body + j] = contacts.J[c, side, 0, j]
                    else:
                        H[r, 6 * body + j] = (
                            system.cosines[i - 1] * contacts.J[c, side, 1, j]
                            + system.sines[i - 1] * contacts.J[c, side, 2, j]
                        )
    solved = H.copy()
    solved[N, :size] = system.momentum
    for r in range(system.num_rows):
        solved[N, size + r] = -system.bias_e[r]
    for r in range(N + 1):
        lu_solve(n, work.S, work.pivot, solved[r])
    for r in range(N):
        c, i = rows[r, 0], rows[r, 1]
        bias = 0.0
        if i == 0:
            bias = contacts.bias[c, 0]
        elif i <= k:
            bias = system.cosines[i - 1] * contacts.bias[c, 1] + system.sines[i - 1] * contacts.bias[c, 2]
        scale = speed if i <= k else impulse
        total = bias
        for j in range(n):
            total += H[r, j] * solved[N, j]
        vector[r] = total / scale
        for q in range(N):
            total = 0.0
            for j in range(n):
                total += H[r, j] * solved[q, j]
            if rows[q, 0] == c:
                i2 = rows[q, 1]
                if i == i2 and i <= k:
                    total += system.contact_compliance
                elif i2 == k + 1 and 1 <= i <= k:
                    total += 1.0
                elif i == k + 1 and 1 <= i2 <= k:
                    total -= 1.0
                elif i == k + 1 and i2 == 0:
                    total += contacts.mu[c]
            matrix[r, q] = total * (impulse if rows[q, 1] <= k else speed) / scale
    return True


@allocating_kernel
def lemke(matrix, vector, positive, perturbation):
    """Set of positive z in s = matrix z + vector, s z = 0, s, z >= 0, found by complementary pivoting.

    Args:
        matrix: (N, N).
        vector: (N,).
        positive: (N,) uint8, receives 1 where z is basic.
        perturbation: the vector is perturbed by about this, so that no two ratios tie: the problem is degenerate at
            every contact that is open or loads some friction directions only.

    Returns:
        Whether a solution was found.
    """
    N = vector.shape[0]
    # Columns: s (0..N-1), z (N..2N-1), z_0 (2N), right-hand side (2N+1). Those of s hold the inverse of the basis.
    T = np.zeros((N, 2 * N + 2))
    basis = np.arange(N)
    row = 0
    for r in range(N):
        T[r, r] = 1.0
        for c in range(N):
            T[r, N + c] = -matrix[r, c]
        T[r, 2 * N] = -1.0
        # Multiples of the golden ratio, modulo 1, are spread evenly.
        T[r, 2 * N + 1] = vector[r] + perturbation * (1.0 + (r * 0.6180339887498949) % 1.0)
        if T[r, 2 * N + 1] < T[row, 2 * N + 1]:
            row = r
    positive[:] = 0
    if T[row, 2 * N + 1] >= 0.0:
        return True
    entering = 2 * N
    for _ in range(_PIVOTS * N):
        inverse = 1.0 / T[row, entering]
        for c in range(2 * N + 2):
            T[row, c] *= inverse
        for r in range(N):
            factor = T[r, entering]
            if r != row and factor != 0.0:
                for c in range(2 * N + 2):
                    T[r, c] -= factor * T[row, c]
        leaving = basis[row]
        basis[row] = entering
        if leaving == 2 * N:
            for r in range(N):
                if N <= basis[r] < 2 * N:
                    positive[basis[r] - N] = 1
            return True
        entering = leaving + N if leaving < N else leaving - N
        row = -1
        smallest = 0.0
        for r in range(N):
            if T[r, entering] > _PIVOT:
                ratio = T[r, 2 * N + 1] / T[r, entering]
                # Ties go to z_0, whose leaving ends the search.
                if row < 0 or ratio < smallest or (ratio == smallest and basis[r] == 2 * N):
                    row, smallest = r, ratio
        if row < 0:
            return False
    return False


@allocating_kernel
def solve_by_lemke(system, contacts, work, impulse, speed, perturbation):
    """Leaves the active set that Lemke's method finds in work.active; False if it finds none."""
    k = len(system.cosines)
    N = 0
    for c in range(contacts.number[0]):
        N += k + 2 if contacts.mu[c] > 0.0 else 1
    rows = np.zeros((N, 2), np.int64)
    r = 0
    for c in range(contacts.number[0]):
        for i in range(k + 2 if contacts.mu[c] > 0.0 else 1):
            rows[r, 0] = c
            rows[r, 1] = i
            r += 1
    matrix, vector, positive = np.zeros((N, N)), np.zeros(N), np.zeros(N, np.uint8)
    if not standard_form(system, contacts, work, impulse, speed, rows, matrix, vector):
        return False
    if not lemke(matrix, vector, positive, perturbation):
        return False
    work.active[:] = 0
    for r in range(N):
        work.active[rows[r, 0], rows[r, 1]] = positive[r]
    return True
