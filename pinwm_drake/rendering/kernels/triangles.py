# SPDX-License-Identifier: MIT
"""Triangles of meshes in images: the pixels that they cover, and their depths there (numba)."""

import numpy as np

from pinwm_drake.jit import entry_point


@entry_point
def mark_triangles(triangles, marked):
    """Mark the pixels whose centres lie in some triangle.

    Args:
        triangles: (n, 3, 2) float64, x and y of the corners in px.
        marked: (height, width) float32, receives 1 in triangles and is left alone elsewhere.
    """
    height, width = marked.shape
    for t in range(triangles.shape[0]):
        y0, y1, y2 = triangles[t, 0, 1] - 0.5, triangles[t, 1, 1] - 0.5, triangles[t, 2, 1] - 0.5
        for row in range(max(int(np.ceil(min(y0, y1, y2))), 0), min(int(np.floor(max(y0, y1, y2))), height - 1) + 1):
            # The row's interval inside the triangle, from the edges that cross it.
            low, high = np.inf, -np.inf
            for edge in range(3):
                a, b = triangles[t, edge], triangles[t, (edge + 1) % 3]
                xa, ya, xb, yb = a[0] - 0.5, a[1] - 0.5, b[0] - 0.5, b[1] - 0.5
                if min(ya, yb) <= row <= max(ya, yb) and ya != yb:
                    x = xa + (row - ya) / (yb - ya) * (xb - xa)
                    low, high = min(low, x), max(high, x)
            if low <= high:
                for column in range(max(int(np.ceil(low)), 0), min(int(np.floor(high)), width - 1) + 1):
                    marked[row, column] = np.float32(1.0)


@entry_point
def fill_depths(corners, triangles, intrinsics, near, depth, first, last):
    """Write the depths of triangles in views first..last-1 where they are below what stands there.

    Args:
        corners: (V, n, 3) float64, camera frame, m.
        triangles: (m, 3) int64, rows of `corners`.
        intrinsics: (1, 4) or (V, 4) float64, fx, fy, cx, cy, px.
        near: m, what is nearer is left out.
        depth: (V, H, W) float32, m; changed in place.
        first, last: range of the views.
    """
    _, height, width = depth.shape
    for v in range(first, last):
        fx, fy, cx, cy = intrinsics[v % len(intrinsics)]
        for t in range(triangles.shape[0]):
            ax, ay, az = corners[v, triangles[t, 0]]
            bx, by, bz = corners[v, triangles[t, 1]]
            dx, dy, dz = corners[v, triangles[t, 2]]
            if max(az, bz, dz) < near:
                continue
            left, right, top, bottom = 0, width - 1, 0, height - 1
            if min(az, bz, dz) >= near:
                x0, x1, x2 = fx * ax / az + cx, fx * bx / bz + cx, fx * dx / dz + cx
                y0, y1, y2 = fy * ay / az + cy, fy * by / bz + cy, fy * dy / dz + cy
                # As floats first: a corner far outside has no place among whole numbers.
                left = int(min(max(np.ceil(min(x0, x1, x2) - 0.5), 0.0), width))
                right = int(max(min(np.floor(max(x0, x1, x2) - 0.5), width - 1.0), -1.0))
                top = int(min(max(np.ceil(min(y0, y1, y2) - 0.5), 0.0), height))
                bottom = int(max(min(np.floor(max(y0, y1, y2) - 0.5), height - 1.0), -1.0))
            # Normals of the planes through the camera's centre and an edge: b x d, d x a, a x b.
            ux, uy, uz = by * dz - bz * dy, bz * dx - bx * dz, bx * dy - by * dx
            vx, vy, vz = dy * az - dz * ay, dz * ax - dx * az, dx * ay - dy * ax
            wx, wy, wz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
            volume = ax * ux + ay * uy + az * uz
            if volume == 0.0:
                continue
            sign = 1.0 if volume > 0.0 else -1.0
            for row in range(top, bottom + 1):
                y = (row + 0.5 - cy) / fy
                for column in range(left, right + 1):
                    x = (column + 0.5 - cx) / fx
                    # The ray z (x, y, 1) is a sum of the corners with these weights, over the volume.
                    p = sign * (ux * x + uy * y + uz)
                    q = sign * (vx * x + vy * y + vz)
                    r = sign * (wx * x + wy * y + wz)
                    total = p + q + r
                    if p >= 0.0 and q >= 0.0 and r >= 0.0 and total > 0.0:
                        z = sign * volume / total
                        if near <= z < depth[v, row, column]:
                            depth[v, row, column] = np.float32(z)
