# SPDX-License-Identifier: MIT
"""Columns of the table of projected surfels, which projection writes and blending reads; numbers of both, float32."""

import numpy as np

from pinwm_drake.rendering import reference

# A surfel's plane seen from a pixel that is (dx, dy) px from the projected centre (XC, YC):
#   q_0 = J00 dx + J01 dy,  q_1 = J10 dx + J11 dy,  q_2 = 1 + P0 dx + P1 dy,
#   u = q_0 / q_2,  v = q_1 / q_2,  z = Z / q_2,
# which is `reference.py`'s q divided by its value at the centre.
XC, YC, J00, J01, J10, J11, P0, P1, Z, OPACITY, RED, GREEN, BLUE, NX, NY, NZ = range(16)
COLUMNS = 16

# Tiles of the image, px; vector instructions work on pairs of a tile's rows.
TILE = 8
PIXELS = TILE * TILE

ZERO, HALF, ONE, TWO, FOUR = (np.float32(value) for value in (0.0, 0.5, 1.0, 2.0, 4.0))
NEAR = np.float32(reference.NEAR)
LEAST_ALPHA = np.float32(reference.LEAST_ALPHA)
