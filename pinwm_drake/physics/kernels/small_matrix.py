# SPDX-License-Identifier: MIT
"""LU factors and solves of the small dense systems of a step (numba)."""

from pinwm_drake.jit import kernel, small_kernel


@small_kernel
def lu_factor(n, S, pivot):
    """Factors S = P L U in place with partial pivoting.

    Args:
        n: order.
        S: (>=n, >=n), overwritten by the factors; the diagonal of U is stored inverted.
        pivot: (>=n,), receives the row exchanges.

    Returns:
        False if a pivot vanished.
    """
    for j in range(n):
        best, row = abs(S[j, j]), j
        for i in range(j + 1, n):
            value = abs(S[i, j])
            if value > best:
                best, row = value, i
        pivot[j] = row
        if not best > 0.0:
            return False
        if row != j:
            for c in range(n):
                S[j, c], S[row, c] = S[row, c], S[j, c]
        inverse = 1.0 / S[j, j]
        S[j, j] = inverse
        for i in range(j + 1, n):
            factor = S[i, j] * inverse
            S[i, j] = factor
            if factor != 0.0:
                for c in range(j + 1, n):
                    S[i, c] -= factor * S[j, c]
    return True


@small_kernel
def lu_solve(n, S, pivot, x):
    """Solves S x = b in place, x holding b, with the factors of `lu_factor`."""
    for j in range(n):
        row = pivot[j]
        if row != j:
            x[j], x[row] = x[row], x[j]
    for i in range(1, n):
        total = x[i]
        for c in range(i):
            total -= S[i, c] * x[c]
        x[i] = total
    for i in range(n - 1, -1, -1):
        total = x[i]
        for c in range(i + 1, n):
            total -= S[i, c] * x[c]
        x[i] = total * S[i, i]


@kernel
def lu_solve_transposed(n, S, pivot, x):
    """Solves S' x = b in place, x holding b, with the factors of `lu_factor`."""
    for i in range(n):
        total = x[i]
        for c in range(i):
            total -= S[c, i] * x[c]
        x[i] = total * S[i, i]
    for i in range(n - 2, -1, -1):
        total = x[i]
        for c in range(i + 1, n):
            total -= S[c, i] * x[c]
        x[i] = total
    for j in range(n - 1, -1, -1):
        row = pivot[j]
        if row != j:
            x[j], x[row] = x[row], x[j]
