"""Mask of the pixels that the triangles of a mesh cover (numba)."""

import numpy as np

from pinwm_drake.jit import entry_point


@entry_point
def mark_triangles(triangles, marked):
    """Marks the pixels whose centres lie in some triangle.

    Args:
        triangles: (n, 3, 2) float64, x and y of the corners in px.
        marked: (height, width) float32, receives 1 in triangles and is left alone elsewhere.
    """
    height, width = marked.shape
    for t in range(triangles.shape[0]):
        x0, y0 = triangles[t, 0, 0] - 0.5, triangles[t, 0, 1] - 0.5
        x1, y1 = triangles[t, 1, 0] - 0.5, triangles[t, 1, 1] - 0.5
        x2, y2 = triangles[t, 2, 0] - 0.5, triangles[t, 2, 1] - 0.5
        for row in range(max(int(np.ceil(min(y0, y1, y2))), 0), min(int(np.floor(max(y0, y1, y2))), height - 1) + 1):
            # The row's interval inside the triangle, from the edges that cross it.
            low, high = np.inf, -np.inf
            for edge in range(3):
                if edge == 0:
                    xa, ya, xb, yb = x0, y0, x1, y1
                elif edge == 1:
                    xa, ya, xb, yb = x1, y1, x2, y2
                else:
                    xa, ya, xb, yb = x2, y2, x0, y0
                if min(ya, yb) <= row <= max(ya, yb) and ya != yb:
                    x = xa + (row - ya) / (yb - ya) * (xb - xa)
                    low, high = min(low, x), max(high, x)
            if low <= high:
                for column in range(max(int(np.ceil(low)), 0), min(int(np.floor(high)), width - 1) + 1):
                    marked[row, column] = np.float32(1.0)
