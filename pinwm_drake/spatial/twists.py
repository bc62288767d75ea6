"""Spatial velocities [ω; v]: another reference point, and the pose they lead to."""

import torch

from pinwm_drake.spatial.checks import require_last_axis
from pinwm_drake.spatial.poses import Pose
from pinwm_drake.spatial.rotations import normalize_quaternion, quaternion_exp, quaternion_multiply, turn_between


def shift(V_WB: torch.Tensor, p_BC_W: torch.Tensor) -> torch.Tensor:
    """The spatial velocity of a point C fixed in body B: ω stays, v_C = v_B + ω × p_BC.

    Args:
        V_WB: (..., 6) [rad/s; m/s], at B, in W.
        p_BC_W: (..., 3) [m], from B to C, in W.

    Returns:
        V_WC: (..., 6) [rad/s; m/s], at C, in W.

    Raises:
        StateError: When a last axis has the wrong length.
    """
    require_last_axis(V_WB, 6, "V_WB")
    require_last_axis(p_BC_W, 3, "p_BC_W")
    w, p_BC_W = torch.broadcast_tensors(V_WB[..., :3], p_BC_W)
    return torch.cat((w, V_WB[..., 3:] + torch.linalg.cross(w, p_BC_W)), dim=-1)


def integrate_pose(X_WB: Pose, V_WB: torch.Tensor, duration: float | torch.Tensor) -> Pose:
    """The pose after moving with a constant spatial velocity: p + v h and exp(ω h) ⊗ q.

    Exact for constant ω, and for a constant velocity of the body origin.

    Args:
        X_WB: Pose of B in W, leading axes (...).
        V_WB: (..., 6) [rad/s; m/s], at B, in W.
        duration: h [s], one number.

    Returns:
        X_WB: The later pose; its quaternion is normalised.

    Raises:
        StateError: When an array has the wrong last axis.
    """
    require_last_axis(V_WB, 6, "V_WB")
    require_last_axis(X_WB.p, 3, "p_WB")
    q_WB = quaternion_multiply(quaternion_exp(V_WB[..., :3] * duration), X_WB.q)
    return Pose(normalize_quaternion(q_WB), X_WB.p + V_WB[..., 3:] * duration)


def velocity_between(X_WB: Pose, X_WB_later: Pose, duration: float | torch.Tensor) -> torch.Tensor:
    """The constant spatial velocity that leads from one pose to another: the inverse of `integrate_pose`.

    Args:
        X_WB: Pose of B in W, leading axes (...).
        X_WB_later: Its pose `duration` later, turned by less than π.
        duration: h [s], one number, not zero.

    Returns:
        V_WB: (..., 6) [rad/s; m/s], at B, in W.

    Raises:
        StateError: When an array has the wrong last axis.
    """
    require_last_axis(X_WB.p, 3, "p_WB")
    require_last_axis(X_WB_later.p, 3, "p_WB_later")
    turn = turn_between(X_WB.q, X_WB_later.q)
    return torch.cat((turn, X_WB_later.p - X_WB.p), dim=-1) / duration
