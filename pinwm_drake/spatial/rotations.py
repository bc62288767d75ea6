# SPDX-License-Identifier: MIT
"""Unit quaternions (w, x, y, z), rotation matrices and rotation vectors.

Every function takes any leading batch axes, broadcasts them, and is differentiable. It raises StateError where a last
axis has another length than is stated. The exponential and the logarithm are smooth through the identity: near it they
switch to Taylor series whose remainder is below the rounding of float64.

Source: the quaternion formulas of J. Solà, "Quaternion kinematics for the error-state Kalman filter" (2017),
sections 1 and 4, with Drake's monogram notation.
"""

import torch

from pinwm_drake.errors import StateError

# Below this square of an angle [rad²] a series replaces sin(x)/x and atan(x)/x. The first neglected terms are
# x⁸/9! and x¹⁰/11: under 1e-21 of the value.
_SMALL_SQUARE = 1e-4


def require_last_axis(array: torch.Tensor, size: int, name: str) -> None:
    """Raise StateError unless a tensor, which the message calls `name`, has the shape (..., size)."""
    if array.ndim == 0 or array.shape[-1] != size:
        raise StateError(f"{name}: got shape {tuple(array.shape)}; allowed: (..., {size})")


def quaternion_multiply(q_AB: torch.Tensor, q_BC: torch.Tensor) -> torch.Tensor:
    """Return the quaternion q_AC = q_AB ⊗ q_BC of R_AC = R_AB R_BC.

    Args:
        q_AB: (..., 4), wxyz.
        q_BC: (..., 4), wxyz.

    Returns:
        q_AC: (..., 4), wxyz, of unit norm when both factors are.
    """
    require_last_axis(q_AB, 4, "q_AB")
    require_last_axis(q_BC, 4, "q_BC")
    aw, ax, ay, az = q_AB.unbind(-1)
    bw, bx, by, bz = q_BC.unbind(-1)
    return torch.stack(
        (
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ),
        dim=-1,
    )


def quaternion_conjugate(q_AB: torch.Tensor) -> torch.Tensor:
    """Return the quaternion q_BA of the inverse rotation.

    Args:
        q_AB: (..., 4), wxyz, unit norm.

    Returns:
        q_BA: (..., 4), wxyz.
    """
    require_last_axis(q_AB, 4, "q_AB")
    return torch.cat((q_AB[..., :1], -q_AB[..., 1:]), dim=-1)


def normalize_quaternion(q_AB: torch.Tensor) -> torch.Tensor:
    """Scales a quaternion to unit norm; the sign stays.

    Args:
        q_AB: (..., 4), wxyz, not zero (a zero quaternion gives NaN).

    Returns:
        q_AB: (..., 4), wxyz, unit norm.
    """
    require_last_axis(q_AB, 4, "q_AB")
    return q_AB / torch.linalg.vector_norm(q_AB, dim=-1, keepdim=True)


def quaternion_to_matrix(q_AB: torch.Tensor) -> torch.Tensor:
    """Return the rotation matrix of a unit quaternion.

    Args:
        q_AB: (..., 4), wxyz, unit norm.

    Returns:
        R_AB: (..., 3, 3).
    """
    require_last_axis(q_AB, 4, "q_AB")
    w, x, y, z = q_AB.unbind(-1)
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    return torch.stack([torch.stack(row, dim=-1) for row in rows], dim=-2)


def matrix_to_quaternion(R_AB: torch.Tensor) -> torch.Tensor:
    """Return the unit quaternion of a rotation matrix, with w ≥ 0.

    The matrix 4 q qᵀ is linear in R; its row with the largest diagonal is a well-conditioned multiple of q
    (Shepperd's method). Two rotations by nearly π about the same axis may differ in sign.

    Args:
        R_AB: (..., 3, 3), orthonormal, determinant +1.

    Returns:
        q_AB: (..., 4), wxyz, unit norm, w ≥ 0.
    """
    require_last_axis(R_AB, 3, "R_AB")
    require_last_axis(R_AB[..., 0], 3, "first column of R_AB")
    a, b, c, d, e, f, g, h, i = R_AB.flatten(-2).unbind(-1)
    rows = (
        (1 + a + e + i, h - f, c - g, d - b),
        (h - f, 1 + a - e - i, b + d, c + g),
        (c - g, b + d, 1 - a + e - i, f + h),
        (d - b, c + g, f + h, 1 - a - e + i),
    )
    outer = torch.stack([torch.stack(row, dim=-1) for row in rows], dim=-2)
    best = outer.diagonal(dim1=-2, dim2=-1).argmax(dim=-1)
    row = outer.gather(-2, best[..., None, None].expand(*best.shape, 1, 4)).squeeze(-2)
    return normalize_quaternion(torch.where(row[..., :1] < 0, -row, row))


def rotate(q_AB: torch.Tensor, v_B: torch.Tensor) -> torch.Tensor:
    """Re-expresses a vector: v_A = R_AB v_B.

    Args:
        q_AB: (..., 4), wxyz, unit norm.
        v_B: (..., 3), in frame B, any unit.

    Returns:
        v_A: (..., 3), in frame A, the same unit.
    """
    require_last_axis(q_AB, 4, "q_AB")
    require_last_axis(v_B, 3, "v_B")
    u, v_B = torch.broadcast_tensors(q_AB[..., 1:], v_B)
    t = 2 * torch.linalg.cross(u, v_B)
    return v_B + q_AB[..., :1] * t + torch.linalg.cross(u, t)


def quaternion_exp(theta_A: torch.Tensor) -> torch.Tensor:
    """Return the quaternion of a rotation vector: cos(|θ|/2) + sin(|θ|/2) θ/|θ|.

    Args:
        theta_A: (..., 3) [rad], axis times angle.

    Returns:
        q: (..., 4), wxyz, unit norm.
    """
    require_last_axis(theta_A, 3, "theta_A")
    half = 0.5 * theta_A
    square = half.square().sum(-1, keepdim=True)
    small = square < _SMALL_SQUARE
    angle = torch.where(small, 1.0, square).sqrt()
    cosine = torch.where(small, 1 - square / 2 + square**2 / 24 - square**3 / 720, angle.cos())
    sinc = torch.where(small, 1 - square / 6 + square**2 / 120 - square**3 / 5040, angle.sin() / angle)
    return torch.cat((cosine, sinc * half), dim=-1)


def quaternion_log(q_AB: torch.Tensor) -> torch.Tensor:
    """Return the rotation vector of a quaternion, the shorter way round: |θ| ≤ π.

    q and -q give the same vector. At |θ| = π the axis, and so the gradient, jumps to the other side.

    Args:
        q_AB: (..., 4), wxyz; the norm does not matter.

    Returns:
        theta: (..., 3) [rad], the same in A and B.
    """
    require_last_axis(q_AB, 4, "q_AB")
    q = torch.where(q_AB[..., :1] < 0, -q_AB, q_AB)
    w, u = q[..., :1], q[..., 1:]
    square = u.square().sum(-1, keepdim=True)
    small = square < _SMALL_SQUARE * w.square()
    sine = torch.where(small, 1.0, square).sqrt()
    safe_w = torch.where(small, w, 1.0)
    x2 = torch.where(small, square / safe_w.square(), 0.0)
    series = (1 - x2 / 3 + x2**2 / 5 - x2**3 / 7 + x2**4 / 9) / safe_w
    return 2 * torch.where(small, series, torch.atan2(sine, w) / sine) * u


def turn_between(q_AB: torch.Tensor, q_AC: torch.Tensor) -> torch.Tensor:
    """Rotation vector, in A, that turns B into C the shorter way: exp(θ) q_AB = ± q_AC.

    Args:
        q_AB: (..., 4), wxyz; the norm does not matter.
        q_AC: (..., 4), wxyz.

    Returns:
        theta_A: (..., 3) [rad].
    """
    return quaternion_log(quaternion_multiply(q_AC, quaternion_conjugate(q_AB)))
