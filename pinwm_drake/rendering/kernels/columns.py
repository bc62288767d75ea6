"""Columns of the table of projected surfels, which projection writes and blending reads; all float32."""

# A surfel's plane seen from a pixel that is (dx, dy) px from the projected centre (XC, YC):
#   q_0 = J00 dx + J01 dy,  q_1 = J10 dx + J11 dy,  q_2 = 1 + P0 dx + P1 dy,
#   u = q_0 / q_2,  v = q_1 / q_2,  z = Z / q_2,
# which is `reference.py`'s q divided by its value at the centre.
XC, YC, J00, J01, J10, J11, P0, P1, Z, OPACITY, RED, GREEN, BLUE, NX, NY, NZ = range(16)
COLUMNS = 16

# Tiles of the image, px; vector instructions work on pairs of a tile's rows.
TILE = 8
PIXELS = TILE * TILE
