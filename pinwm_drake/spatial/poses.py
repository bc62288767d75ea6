# SPDX-License-Identifier: MIT
"""Rigid poses X_AB = (R_AB, p_AB), with the rotation held as a unit quaternion.

Every function raises StateError where a part has another last axis than is stated.
"""

from typing import NamedTuple

import torch

from pinwm_drake.errors import StateError
from pinwm_drake.spatial.rotations import (
    quaternion_conjugate,
    quaternion_multiply,
    quaternion_to_matrix,
    require_last_axis,
    rotate,
)


class Pose(NamedTuple):
    """The pose X_AB of frame B in frame A, or a batch of poses.

    Attributes:
        q: q_AB (..., 4), wxyz, unit norm.
        p: p_AB (..., 3) [m], origin of B from the origin of A, in A.
    """

    q: torch.Tensor
    p: torch.Tensor


def identity(*batch: int) -> Pose:
    """Return the pose that changes nothing.

    Args:
        *batch: Lengths of the leading axes.

    Returns:
        X_AA: q (*batch, 4), p (*batch, 3) [m], float64.

    Raises:
        StateError: When a length is negative.
    """
    if any(length < 0 for length in batch):
        raise StateError(f"batch: got {batch}; allowed: lengths of 0 or more")
    q = torch.zeros(*batch, 4, dtype=torch.float64)
    q[..., 0] = 1
    return Pose(q, torch.zeros(*batch, 3, dtype=torch.float64))


def compose(X_AB: Pose, X_BC: Pose) -> Pose:
    """Return the pose X_AC = X_AB X_BC.

    Args:
        X_AB: Pose of B in A, leading axes (...).
        X_BC: Pose of C in B, leading axes (...).

    Returns:
        X_AC: Pose of C in A, leading axes broadcast.
    """
    return Pose(quaternion_multiply(X_AB.q, X_BC.q), transform(X_AB, X_BC.p))


def inverse(X_AB: Pose) -> Pose:
    """Return the pose X_BA of A in B.

    Args:
        X_AB: Pose of B in A, leading axes (...).

    Returns:
        X_BA: Pose of A in B.
    """
    q_BA = quaternion_conjugate(X_AB.q)
    return Pose(q_BA, -rotate(q_BA, X_AB.p))


def transform(X_AB: Pose, p_BQ: torch.Tensor) -> torch.Tensor:
    """Return the position of a point Q in A, given its position in B.

    Args:
        X_AB: Pose of B in A, leading axes (...).
        p_BQ: (..., 3) [m], in B.

    Returns:
        p_AQ: (..., 3) [m], in A.
    """
    require_last_axis(X_AB.p, 3, "p_AB")
    return X_AB.p + rotate(X_AB.q, p_BQ)


def pose_to_matrix(X_AB: Pose) -> torch.Tensor:
    """Return the homogeneous matrix of a pose.

    Args:
        X_AB: Pose of B in A, leading axes (...).

    Returns:
        X_AB: (..., 4, 4); the translation in metres.
    """
    require_last_axis(X_AB.p, 3, "p_AB")
    R_AB = quaternion_to_matrix(X_AB.q)
    upper = torch.cat((R_AB, X_AB.p.unsqueeze(-1).expand(*R_AB.shape[:-1], 1)), dim=-1)
    lowest = torch.zeros_like(upper[..., :1, :])
    lowest[..., 3] = 1
    return torch.cat((upper, lowest), dim=-2)
