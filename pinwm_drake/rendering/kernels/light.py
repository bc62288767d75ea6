# SPDX-License-Identifier: MIT
"""Light on surfels (numba)."""

from pinwm_drake.jit import entry_point
from pinwm_drake.rendering.kernels.columns import HALF, ONE, ZERO
from pinwm_drake.rendering.kernels.harmonics import Y0

_OFFSET = HALF / Y0  # in the first harmonic, what a colour has beside the sum of its harmonics


@entry_point
def light_surfels(sh, p_OS, n_OS, eyes, lights, lit, first, last):
    """Write the harmonics of surfels in a light, for views first..last-1: each keeps a share a + g n of its colour.

    The normal n is on the side of the camera; a share is at least 0.

    Args:
        sh: (1 or V, N, K, 3).
        p_OS, n_OS: (N, 3), centres and unit normals, frame O.
        eyes: (V, 3), places of the cameras, frame O.
        lights: (V, 4), a, and g in frame O.
        lit: (V, N, K, 3), receives the harmonics.
        first, last: range of the views.
    """
    for v in range(first, last):
        own = v if sh.shape[0] > 1 else 0
        a, gx, gy, gz = lights[v, 0], lights[v, 1], lights[v, 2], lights[v, 3]
        for s in range(sh.shape[1]):
            nx, ny, nz = n_OS[s, 0], n_OS[s, 1], n_OS[s, 2]
            away = nx * (eyes[v, 0] - p_OS[s, 0]) + ny * (eyes[v, 1] - p_OS[s, 1]) + nz * (eyes[v, 2] - p_OS[s, 2])
            toward = gx * nx + gy * ny + gz * nz
            share = max(a - toward if away < ZERO else a + toward, ZERO)
            for k in range(sh.shape[2]):
                for c in range(3):
                    lit[v, s, k, c] = share * sh[own, s, k, c]
            for c in range(3):
                lit[v, s, 0, c] += (share - ONE) * _OFFSET
