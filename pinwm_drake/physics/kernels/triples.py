# SPDX-License-Identifier: MIT
"""Small vectors and matrices as the adjoint takes them: sequences in, tuples out (numba)."""

import math

from pinwm_drake.jit import kernel


@kernel
def cross(a, b):
    """Return the cross product of two vectors."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@kernel
def dot(a, b):
    """Return the dot product of two vectors."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@kernel
def add(out, start, scale, v):
    """Add `scale` of v to three entries of out, from `start` on."""
    out[start] += scale * v[0]
    out[start + 1] += scale * v[1]
    out[start + 2] += scale * v[2]


@kernel
def multiply(M, v):
    """Product of a 3 x 3 matrix with v."""
    return dot(M[0], v), dot(M[1], v), dot(M[2], v)


@kernel
def multiply_transposed(M, v):
    """Product of a transposed 3 x 3 matrix with v."""
    return (
        M[0, 0] * v[0] + M[1, 0] * v[1] + M[2, 0] * v[2],
        M[0, 1] * v[0] + M[1, 1] * v[1] + M[2, 1] * v[2],
        M[0, 2] * v[0] + M[1, 2] * v[1] + M[2, 2] * v[2],
    )


@kernel
def rotation_adjoint(phi, bar):
    """Gradients with respect to phi and to R's own rotation vector, from that of R' = exp(phi) R."""
    angle2 = dot(phi, phi)
    if angle2 < 1e-8:
        sine, b, c = 1.0 - angle2 / 6.0, 0.5 - angle2 / 24.0, 1.0 / 6.0 - angle2 / 120.0
    else:
        angle = math.sqrt(angle2)
        sine = math.sin(angle) / angle
        b = (1.0 - math.cos(angle)) / angle2
        c = (1.0 - sine) / angle2
    u = cross(phi, bar)
    w = cross(phi, u)
    # Transposes of J_l = 1 + b [phi]x + c [phi]x^2 and exp(phi) = 1 + sine [phi]x + b [phi]x^2.
    return (
        (bar[0] - b * u[0] + c * w[0], bar[1] - b * u[1] + c * w[1], bar[2] - b * u[2] + c * w[2]),
        (bar[0] - sine * u[0] + b * w[0], bar[1] - sine * u[1] + b * w[1], bar[2] - sine * u[2] + b * w[2]),
    )
