"""Drift of a real object away from what the physics predicts, as a random walk along the way that it makes."""

import torch
from torch import Tensor

from pinwm_drake.spatial.poses import Pose
from pinwm_drake.spatial.rotations import turn_between

# Standard deviation of a position after a way of one metre, m; an angle's is this over the object's radius. Out of the
# floor's plane this share of it. From pushes of MuJoCo, Bullet and Drake: see docs/results.md.
WALK, OUT_OF_PLANE = 5e-3, 0.1


def way(X_WO: Pose, times: Tensor, radius: float) -> Tensor:
    """Way (..., n) [m] that objects have made up to each of their poses.

    A turn counts as what it moves the object's rim by.

    Args:
        X_WO: q (..., n, 4), p (..., n, 3), m.
        times: (n,), of the poses, s; in any order.
        radius: Of the object, m.
    """
    order = torch.argsort(times)
    q, p = X_WO.q[..., order, :], X_WO.p[..., order, :]
    turned = turn_between(q[..., :-1, :], q[..., 1:, :]).norm(dim=-1)
    step = (p[..., 1:, :] - p[..., :-1, :]).norm(dim=-1) + radius * turned
    made = torch.nn.functional.pad(step, (1, 0)).cumsum(-1)
    return torch.empty_like(made).index_copy(-1, order, made)


def drift(radius: float) -> Tensor:
    """Standard deviations (6,) of rotation vector [rad] and position [m], world axes, after a way of one metre."""
    share = torch.tensor([OUT_OF_PLANE, OUT_OF_PLANE, 1.0, 1.0, 1.0, OUT_OF_PLANE], dtype=torch.float64)
    return WALK * share * per_radius(radius)


def per_radius(radius: float) -> Tensor:
    """Factors (6,) from a shift of the rim [m] to rotation vector [rad] and position [m]."""
    return torch.tensor([1.0 / radius] * 3 + [1.0] * 3, dtype=torch.float64)
