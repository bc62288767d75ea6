# SPDX-License-Identifier: MIT
"""The rasteriser in plain torch: every surfel against every pixel. It is the oracle of the tests, and runs on CUDA.

With the surfel's scaled tangents a, b and its centre c in the camera frame, the ray d = ((x - cx) / fx,
(y - cy) / fy, 1) meets its plane where u a + v b + c = z d. By Cramer's rule, with q = (b x c, c x a, a x b) . d,

    u = q_0 / q_2,   v = q_1 / q_2,   z = det(a, b, c) / q_2,

and the surfel's opacity there is o exp(-rho / 2), rho = u^2 + v^2, or that of a disc of pixel size around the
projected centre where that is larger, so that surfels seen edge-on do not vanish.

Source: Huang et al. (2024), eq. 7 to 12; its released code for the limits below. The distortion is squared, as in that
code, which makes it a function of three sums: sum_ij w_i w_j (z_i - z_j)^2 / 2 = A M_2 - M_1^2.
"""

import torch
from torch import Tensor

from pinwm_drake.rendering.camera import Camera
from pinwm_drake.rendering.harmonics import harmonics
from pinwm_drake.rendering.surfels import Surfels
from pinwm_drake.spatial.poses import Pose
from pinwm_drake.spatial.rotations import quaternion_to_matrix

NEAR = 0.01  # m; nothing nearer is seen
LEAST_ALPHA = 1.0 / 255.0  # what is more transparent does not count
MOST_ALPHA = 0.99
LEAST_TRANSMITTANCE = 1e-4  # a pixel that lets less through takes no more

_CHUNK = 1 << 21  # pixels times surfels that are worked on at once


def render_reference(
    surfels: Surfels, camera: Camera, X_CO: Pose, full: bool, background: Tensor, steepness: Tensor
) -> tuple[Tensor, ...]:
    """Render V views; see `render.render`. Returns color, alpha and, if `full`, depth, normal and distortion."""
    dtype, device = surfels.p_OS.dtype, surfels.p_OS.device
    V = X_CO.p.shape[0]
    R_CO = quaternion_to_matrix(torch.nn.functional.normalize(X_CO.q, dim=-1)).to(device, dtype)
    p_CO = X_CO.p.to(device, dtype)
    intrinsics = camera.intrinsics.to(device, dtype).expand(V, 4)
    steepness = steepness.to(device, dtype)
    background = background.to(device, dtype)
    views = []
    for v in range(V):
        sh = surfels.sh if surfels.sh.ndim == 3 else surfels.sh[v]
        seen = (camera, intrinsics[v], R_CO[v], p_CO[v])
        views.append(_render_view(surfels, sh, *seen, full, background, steepness[v]))
    return tuple(torch.stack(parts) for parts in zip(*views, strict=True))


def _render_view(
    surfels: Surfels,
    sh: Tensor,
    camera: Camera,
    intrinsics: Tensor,
    R_CO: Tensor,
    p_CO: Tensor,
    full: bool,
    background: Tensor,
    steepness: Tensor,
) -> list[Tensor]:
    fx, fy, cx, cy = intrinsics.unbind()
    R_OS = quaternion_to_matrix(torch.nn.functional.normalize(surfels.q_OS, dim=-1))
    scale = surfels.log_scale.exp()
    c = surfels.p_OS @ R_CO.T + p_CO
    order = torch.argsort(c[:, 2].detach(), stable=True)
    order = order[c[order, 2].detach() > NEAR]
    c = c[order]
    a = (scale[:, :1] * R_OS[:, :, 0])[order] @ R_CO.T
    b = (scale[:, 1:] * R_OS[:, :, 1])[order] @ R_CO.T
    n = R_OS[order, :, 2] @ R_CO.T
    n = torch.where((n * c).sum(-1, keepdim=True) > 0.0, -n, n)
    opacity = surfels.logit_opacity[order].sigmoid()
    direction = torch.nn.functional.normalize(surfels.p_OS[order] + R_CO.T @ p_CO, dim=-1)
    basis = harmonics(direction, surfels.degree)
    color = ((basis[:, :, None] * sh[order]).sum(1) + 0.5).clamp_min(0.0)
    adjugate = torch.stack([torch.linalg.cross(b, c), torch.linalg.cross(c, a), torch.linalg.cross(a, b)], 1)
    det = (a * adjugate[:, 0]).sum(-1)
    center = torch.stack([fx * c[:, 0] / c[:, 2] + cx, fy * c[:, 1] / c[:, 2] + cy], -1)
    reference_depth = p_CO[2]

    H, W = camera.height, camera.width
    rows = max(_CHUNK // max(W * len(order), 1), 1)
    columns = torch.arange(W, dtype=c.dtype, device=c.device) + 0.5
    parts = []
    for first in range(0, H, rows):
        y, x = torch.meshgrid(
            torch.arange(first, min(first + rows, H), dtype=c.dtype, device=c.device) + 0.5, columns, indexing="ij"
        )
        x, y = x.reshape(-1, 1), y.reshape(-1, 1)
        ray = torch.cat([(x - cx) / fx, (y - cy) / fy, torch.ones_like(x)], -1)
        q = torch.einsum("nij,pj->pni", adjugate, ray)
        ahead = q[..., 2] * det > 0.0
        w = torch.where(ahead, q[..., 2], det)
        z = det / w
        ahead = ahead & (z > NEAR)
        rho_plane = torch.where(ahead, (q[..., 0] ** 2 + q[..., 1] ** 2) / w**2, torch.inf)
        rho_disc = steepness * ((x - center[:, 0]) ** 2 + (y - center[:, 1]) ** 2)
        on_plane = rho_plane <= rho_disc
        rho = torch.where(on_plane, torch.where(ahead, rho_plane, 0.0), rho_disc)
        alpha = (opacity * torch.exp(-0.5 * rho)).clamp_max(MOST_ALPHA)
        alpha = torch.where(alpha >= LEAST_ALPHA, alpha, 0.0)
        left = torch.cumprod(1.0 - alpha, -1)
        before = torch.cat([torch.ones_like(left[:, :1]), left[:, :-1]], -1)
        weight = torch.where(before > LEAST_TRANSMITTANCE, alpha * before, 0.0)
        covered = weight.sum(-1)
        part = [weight @ color + (1.0 - covered)[:, None] * background, covered]
        if full:
            beyond = torch.where(on_plane, z, c[:, 2]) - reference_depth
            m1, m2 = (weight * beyond).sum(-1), (weight * beyond**2).sum(-1)
            part += [m1 + reference_depth * covered, weight @ n, covered * m2 - m1**2]
        parts.append(part)
    return [torch.cat(values).reshape(H, W, *values[0].shape[1:]) for values in zip(*parts, strict=True)]
