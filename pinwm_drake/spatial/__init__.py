"""Batched rotations, poses and spatial velocities in torch, differentiable throughout."""

from pinwm_drake.spatial.poses import Pose, compose, identity, inverse, pose_to_matrix, transform
from pinwm_drake.spatial.rotations import (
    angle_between,
    matrix_to_quaternion,
    normalize_quaternion,
    quaternion_conjugate,
    quaternion_exp,
    quaternion_log,
    quaternion_multiply,
    quaternion_to_matrix,
    rotate,
)
from pinwm_drake.spatial.twists import integrate_pose, shift, velocity_between

__all__ = [
    "Pose",
    "angle_between",
    "compose",
    "identity",
    "integrate_pose",
    "inverse",
    "matrix_to_quaternion",
    "normalize_quaternion",
    "pose_to_matrix",
    "quaternion_conjugate",
    "quaternion_exp",
    "quaternion_log",
    "quaternion_multiply",
    "quaternion_to_matrix",
    "rotate",
    "shift",
    "transform",
    "velocity_between",
]
