"""Dense primal-dual interior-point method for the mixed LCP, in torch: any device, batched over worlds, no gradient.

Source: Mehrotra (1992); see `kernels/interior_point.py` for the same method with the contacts eliminated.
"""

import torch
from torch import Tensor

from pinwm_drake.physics.lcp import MixedLcp

MAX_ITERATIONS = 100


def _direction(
    lu: tuple[Tensor, Tensor], momentum: Tensor, residual: Tensor, z: Tensor, s: Tensor, target: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    """Newton step (dx, dz, ds) for s dz + z ds = target, with the factored matrix."""
    N = z.shape[-1]
    d = torch.linalg.lu_solve(*lu, torch.cat([momentum, -residual + target / z], -1)[..., None])[..., 0]
    dz = d[..., -N:]
    return d[..., :-N], dz, (target - s * dz) / z


def _step_length(z: Tensor, s: Tensor, dz: Tensor, ds: Tensor) -> Tensor:
    """Longest step (W, 1) that keeps z and s non-negative."""
    ratio = torch.maximum(-dz / z, -ds / s).amax(-1, keepdim=True)
    return 1.0 / ratio.clamp_min(1e-3)


def interior_point(lcp: MixedLcp, x: Tensor, tolerance: float) -> tuple[Tensor, Tensor, Tensor]:
    """Follows the central path until the mean of s z, over its scale, and the residuals are below `tolerance`.

    Args:
        lcp: one problem per world.
        x: (W, n), start, usually the velocity without contacts.
        tolerance: relative; what rounding leaves is accepted when the steps no longer reduce it.

    Returns:
        x (W, n), multipliers z (W, N), slacks s (W, N).
    """
    z, s = lcp.z_scale.clone(), lcp.s_scale.clone()
    N = z.shape[-1]
    eye = torch.eye(N, dtype=z.dtype, device=z.device)
    for _ in range(MAX_ITERATIONS):
        residual = lcp.slack(x, z) - s
        gap = (s * z).mean(-1, keepdim=True)
        done = (gap <= tolerance * lcp.impulse * lcp.speed) & (
            (residual / lcp.s_scale).abs().amax(-1, keepdim=True) <= max(tolerance, 1e-13)
        )
        if bool(done.all()):
            break
        top = torch.cat([lcp.A, -lcp.H.mT], -1)
        bottom = torch.cat([lcp.H, lcp.B + eye * (s / z)[..., None, :]], -1)
        lu = torch.linalg.lu_factor(torch.cat([top, bottom], -2))
        momentum = lcp.p - (lcp.A @ x[..., None])[..., 0] + (lcp.H.mT @ z[..., None])[..., 0]

        _, dz, ds = _direction(lu, momentum, residual, z, s, -s * z)
        alpha = _step_length(z, s, dz, ds).clamp_max(1.0)
        relative = ((z + alpha * dz) * (s + alpha * ds)).mean(-1, keepdim=True) / gap
        target = relative**3 * gap - s * z - dz * ds
        dx, dz, ds = _direction(lu, momentum, residual, z, s, target)
        alpha = (torch.clamp(1.0 - relative, min=0.99) * _step_length(z, s, dz, ds)).clamp_max(1.0)
        alpha = torch.where(done, torch.zeros_like(alpha), alpha)
        x, z, s = x + alpha * dx, z + alpha * dz, s + alpha * ds
    return x, z, s
