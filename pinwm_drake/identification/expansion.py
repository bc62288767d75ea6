# SPDX-License-Identifier: MIT
"""Losses of images around given poses, as quadratic functions of pose and outline in each frame.

Derivatives of the images are central differences, which average over the kinks of pixels. Source: Nocedal and Wright,
Numerical Optimization, section 10.3 (Gauss-Newton).
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from pinwm_drake.identification.image_loss import difference
from pinwm_drake.identification.pictures import Pictures
from pinwm_drake.rendering.surfels import Surfels
from pinwm_drake.spatial.poses import Pose, inverse
from pinwm_drake.spatial.rotations import quaternion_exp, quaternion_multiply, turn_between

# Steps of the differences: in the image, px, and of the outline's logarithm.
_STEP_PIXELS, _STEP_OUTLINE = 0.25, 2e-3
# Frames whose derivatives are held in memory at once.
_TOGETHER = 8


@dataclass(frozen=True, eq=False)
class Expansion:
    """Mean squares L of n frames around poses: L = loss + 2 gradient . d + d' curvature d.

    The argument d is rotation vector [rad], position [m], both in the world's axes, and the outline's logarithm.
    """

    X_WO: Pose  # The poses: q (n, 4), p (n, 3) [m]
    outline: Tensor  # The outline's scale, ()
    loss: Tensor  # (n,)
    gradient: Tensor  # (n, 7)
    curvature: Tensor  # (n, 7, 7)


@torch.no_grad()
def expand(
    pictures: Pictures, surfels: Surfels, X_WO: Pose, outline: Tensor, radius: float, *, num_threads: int | None = None
) -> Expansion:
    """Quadratic model of the losses of n pictures at poses q (n, 4), p (n, 3) [m] and an outline's scale ().

    Args:
        pictures, surfels, num_threads: As for `image_loss.difference`.
        X_WO, outline: Poses and outline about which the images are expanded.
        radius: Radius of the object, m.
    """
    # Of rotation [rad] and position [m], which move the image by about `_STEP_PIXELS`, and of the outline.
    away = (X_WO.p[0] - inverse(Pose(pictures.X_CW.q[0], pictures.X_CW.p[0])).p).norm()
    step = _STEP_PIXELS * float(away) / float(pictures.camera.intrinsics[0, 0])
    steps = (step / radius, step, _STEP_OUTLINE)
    parts = [
        _expand(pictures.some(some), surfels, Pose(X_WO.q[some], X_WO.p[some]), outline, steps, num_threads)
        for some in torch.arange(len(X_WO.p)).split(_TOGETHER)
    ]
    loss, gradient, curvature = (torch.cat(part) for part in zip(*parts, strict=True))
    return Expansion(X_WO, outline, loss, gradient, curvature)


def _expand(
    pictures: Pictures,
    surfels: Surfels,
    X_WO: Pose,
    outline: Tensor,
    steps: tuple[float, float, float],
    num_threads: int | None,
) -> tuple[Tensor, Tensor, Tensor]:
    """Losses (n,), gradients (n, 7) and curvatures (n, 7, 7) of some frames."""
    n = len(X_WO.p)

    def residual(X_WO: Pose, outline: Tensor) -> Tensor:
        X_WO = Pose(X_WO.q[:, None], X_WO.p[:, None])
        return difference(pictures, surfels, X_WO, outline[None], num_threads=num_threads).reshape(n, -1)

    r = residual(X_WO, outline)
    columns = []
    for axis in range(7):
        step = steps[axis // 3]
        sides = []
        for sign in (1.0, -1.0):
            d = torch.zeros(n, 6, dtype=torch.float64)
            if axis < 6:
                d[:, axis] = sign * step
            scale = torch.exp(torch.tensor(sign * step, dtype=torch.float64)) if axis == 6 else 1.0
            sides.append(residual(corrected(X_WO, d), outline * scale))
        columns.append((sides[0] - sides[1]) / (2.0 * step))
    J, M = torch.stack(columns, -1), r.shape[1]
    return (r * r).mean(-1).double(), (J.mT @ r[..., None]).double()[..., 0] / M, (J.mT @ J).double() / M


def corrected(X_WO: Pose, d: Tensor) -> Pose:
    """Poses moved by rotation vectors [rad] and positions [m], (..., 6), in the world's axes."""
    return Pose(quaternion_multiply(quaternion_exp(d[..., :3]), X_WO.q), X_WO.p + d[..., 3:])


def deviation(X_WO: Pose, reference: Pose) -> Tensor:
    """Rotation vectors [rad] and positions [m], (..., 6), that lead from reference poses to others; see `corrected`."""
    return torch.cat([turn_between(reference.q, X_WO.q), X_WO.p - reference.p], -1)
