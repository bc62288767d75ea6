# SPDX-License-Identifier: MIT
"""Small vector algebra (numba).

Vectors are triples of scalars here: numba then keeps them in registers, where a small array would be allocated.
"""

import math

from pinwm_drake.jit import internal_kernel

# Lines whose directions have a cross product below this are parallel: the normal of such a pair is not defined.
PARALLEL_SINE = 1.0e-3


@internal_kernel
def dot(ax, ay, az, bx, by, bz):
    """Scalar product of two vectors."""
    return ax * bx + ay * by + az * bz


@internal_kernel
def cross(ax, ay, az, bx, by, bz):
    """Vector product of two vectors."""
    return ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx


@internal_kernel
def norm(x, y, z):
    """Length of a vector."""
    return math.sqrt(x * x + y * y + z * z)


@internal_kernel
def radial(ux, uy, uz, x, y, z):
    """Part of a vector across the axis u as unit vector and length; zeros along the axis."""
    along = dot(ux, uy, uz, x, y, z)
    x, y, z = x - along * ux, y - along * uy, z - along * uz
    length = norm(x, y, z)
    if length == 0.0:
        return 0.0, 0.0, 0.0, 0.0
    return x / length, y / length, z / length, length


@internal_kernel
def rotate(R, x, y, z):
    """Vector turned by a matrix R (3, 3): R v."""
    return (
        R[0, 0] * x + R[0, 1] * y + R[0, 2] * z,
        R[1, 0] * x + R[1, 1] * y + R[1, 2] * z,
        R[2, 0] * x + R[2, 1] * y + R[2, 2] * z,
    )


@internal_kernel
def rotate_back(R, x, y, z):
    """Vector turned back: R' v for a matrix R (3, 3)."""
    return (
        R[0, 0] * x + R[1, 0] * y + R[2, 0] * z,
        R[0, 1] * x + R[1, 1] * y + R[2, 1] * z,
        R[0, 2] * x + R[1, 2] * y + R[2, 2] * z,
    )


@internal_kernel
def transform(X, x, y, z):
    """Return the transformed point X p, with a pose as twelve scalars: rotation by rows, then position."""
    return (
        X[0] * x + X[1] * y + X[2] * z + X[9],
        X[3] * x + X[4] * y + X[5] * z + X[10],
        X[6] * x + X[7] * y + X[8] * z + X[11],
    )


@internal_kernel
def turn(X, x, y, z):
    """Vector turned by a pose: R v, the pose as for `transform`."""
    return X[0] * x + X[1] * y + X[2] * z, X[3] * x + X[4] * y + X[5] * z, X[6] * x + X[7] * y + X[8] * z


@internal_kernel
def turn_back(X, x, y, z):
    """Vector turned back by a pose: R' v, the pose as for `transform`."""
    return X[0] * x + X[3] * y + X[6] * z, X[1] * x + X[4] * y + X[7] * z, X[2] * x + X[5] * y + X[8] * z


@internal_kernel
def relative_pose(R_WA, p_WA, R_WB, p_WB):
    """Relative pose X_BA as twelve scalars, from the poses of A and B in W."""
    px, py, pz = rotate_back(R_WB, p_WA[0] - p_WB[0], p_WA[1] - p_WB[1], p_WA[2] - p_WB[2])
    xx, yx, zx = rotate_back(R_WB, R_WA[0, 0], R_WA[1, 0], R_WA[2, 0])
    xy, yy, zy = rotate_back(R_WB, R_WA[0, 1], R_WA[1, 1], R_WA[2, 1])
    xz, yz, zz = rotate_back(R_WB, R_WA[0, 2], R_WA[1, 2], R_WA[2, 2])
    return xx, xy, xz, yx, yy, yz, zx, zy, zz, px, py, pz


@internal_kernel
def inverse_pose(X):
    """Inverse pose: X_AB from X_BA, both as twelve scalars."""
    px, py, pz = turn_back(X, -X[9], -X[10], -X[11])
    return X[0], X[3], X[6], X[1], X[4], X[7], X[2], X[5], X[8], px, py, pz


@internal_kernel
def xyz(table, i):
    """Return the first three numbers of a row of one of the table's arrays: a point, direction or normal."""
    return table[i, 0], table[i, 1], table[i, 2]


@internal_kernel
def line_through(X, vertices, v, w):
    """Line from vertex v to vertex w in the frame to which the pose X leads: start, unit direction and length."""
    px, py, pz = transform(X, *xyz(vertices, v))
    dx, dy, dz = transform(X, *xyz(vertices, w))
    dx, dy, dz = dx - px, dy - py, dz - pz
    length = norm(dx, dy, dz)
    return px, py, pz, dx / length, dy / length, dz / length, length


@internal_kernel
def height(table, i, x, y, z):
    """Height [m] of a point over row i of `planes` or `sides`."""
    return table[i, 0] * x + table[i, 1] * y + table[i, 2] * z - table[i, 3]


@internal_kernel
def line_parameters(ux, uy, uz, vx, vy, vz, wx, wy, wz):
    """Nearest points of lines p + s u and q + t v that are not parallel, with w = p - q; s and t in metres.

    Source: C. Ericson, Real-Time Collision Detection, section 5.1.8, with unit directions.
    """
    b, c, f = dot(ux, uy, uz, vx, vy, vz), dot(ux, uy, uz, wx, wy, wz), dot(vx, vy, vz, wx, wy, wz)
    s = (b * f - c) / (1.0 - b * b)
    return s, b * s + f
