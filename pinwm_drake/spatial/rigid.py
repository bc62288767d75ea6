# SPDX-License-Identifier: MIT
"""Rigid transforms X_AB as matrices (4, 4) of NumPy, for adjustments and photos."""

from collections.abc import Sequence

import cv2
import numpy as np
import torch
from scipy.spatial.transform import Rotation

from pinwm_drake.spatial.poses import Pose, pose_to_matrix
from pinwm_drake.spatial.rotations import matrix_to_quaternion

_Vector = np.ndarray | Sequence[float]


def rigid(v: _Vector = (0.0, 0.0, 0.0), w: _Vector = (0.0, 0.0, 0.0)) -> np.ndarray:
    """Transform (4, 4) of a translation v (3,) [m] and a rotation vector w (3,) [rad]."""
    X = np.eye(4)
    X[:3, :3] = cv2.Rodrigues(np.array(w, float))[0]
    X[:3, 3] = v
    return X


def inverse(X_AB: np.ndarray) -> np.ndarray:
    """Transform X_BA (4, 4) of X_AB."""
    X = np.eye(4)
    X[:3, :3] = X_AB[:3, :3].T
    X[:3, 3] = -X_AB[:3, :3].T @ X_AB[:3, 3]
    return X


def apply(X_AB: np.ndarray, p_B: np.ndarray) -> np.ndarray:
    """Points p_A (..., 3) [m] of points p_B (..., 3) [m]."""
    return p_B @ X_AB[:3, :3].T + X_AB[:3, 3]


def turn(R: np.ndarray) -> np.ndarray:
    """Rotation vector (3,) [rad] of a rotation (3, 3) or the rotation of a transform (4, 4)."""
    # OpenCV's inverse of Rodrigues' formula gives 0 below 1e-5 rad.
    turned: np.ndarray = Rotation.from_matrix(R[:3, :3]).as_rotvec()
    return turned


def apart(X: np.ndarray, Y: np.ndarray) -> tuple[float, float]:
    """Distance [m] and angle [rad] between two poses (4, 4) of one frame in another."""
    return float(np.linalg.norm(X[:3, 3] - Y[:3, 3])), float(np.linalg.norm(turn(X[:3, :3].T @ Y[:3, :3])))


def cross(p: np.ndarray) -> np.ndarray:
    """Matrices (N, 3, 3) of the products p x q for p (N, 3)."""
    zero = np.zeros(len(p))
    x, y, z = p.T
    return np.stack([zero, -z, y, z, zero, -x, -y, x, zero], -1).reshape(-1, 3, 3)


def mean(transforms: Sequence[np.ndarray]) -> np.ndarray:
    """Middle (4, 4) of transforms: coordinates of the median, and the rotation nearest to the sum of rotations."""
    stack = np.array(transforms)
    U, _, Vt = np.linalg.svd(stack[:, :3, :3].sum(0))
    X = np.eye(4)
    X[:3, :3] = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
    X[:3, 3] = np.median(stack[:, :3, 3], 0)
    return X


def to_pose(X_AB: np.ndarray) -> Pose:
    """Pose of a transform (4, 4): q (4,), p (3,) [m]."""
    return Pose(matrix_to_quaternion(torch.from_numpy(X_AB[:3, :3].copy())), torch.from_numpy(X_AB[:3, 3].copy()))


def from_pose(X_AB: Pose) -> np.ndarray:
    """Transform (4, 4) of a pose: q (4,), p (3,) [m]."""
    return pose_to_matrix(X_AB).numpy()
