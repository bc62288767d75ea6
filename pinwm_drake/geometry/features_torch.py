# SPDX-License-Identifier: MIT
"""Contact geometry in closed form of feature pairs in torch: the oracle of `features`."""

import torch
from torch import Tensor

from pinwm_drake.geometry.features import CIRCLE, LINE, PLANE, POINT

_TINY = 1e-300
_NEWTON_STEPS = 12


def _dot(a: Tensor, b: Tensor) -> Tensor:
    return (a * b).sum(-1, keepdim=True)


def _unit(v: Tensor) -> Tensor:
    return v / (_dot(v, v) + _TINY).sqrt()


def _perpendicular(v: Tensor, u: Tensor) -> Tensor:
    return v - _dot(v, u) * u


def _through_rim(p: Tensor, d: Tensor, c: Tensor, u: Tensor, r: Tensor) -> Tensor:
    """Point of the line (p, d) nearest to p that is on the cylinder of radius r about the axis (c, u)."""
    y, e = _perpendicular(p - c, u), _perpendicular(d, u)
    b, c0 = _dot(y, e), _dot(y, y) - r * r
    # Elsewhere the root need not exist; its gradient must not be NaN even so.
    root = (b * b - _dot(e, e) * c0).clamp_min(1e-30).sqrt()
    return p - c0 / (b + torch.where(b < 0.0, -root, root)) * d


def _circle_near_line(c: Tensor, u: Tensor, r: Tensor, p: Tensor, d: Tensor) -> Tensor:
    """Radial unit vector of the circle point at a stationary distance to the line (p, d).

    Newton's method from the circle point nearest to p, without gradients; one more step carries them (the implicit
    function theorem).
    """

    def newton(e: Tensor, c: Tensor, u: Tensor, r: Tensor, p: Tensor, d: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        t = torch.linalg.cross(u, e)
        w = _perpendicular(c + r * e - p, d)
        slope = r * (1.0 - _dot(t, d) ** 2) - _dot(w, e)
        return t, _dot(w, t), torch.where(slope == 0.0, torch.ones_like(slope), slope)

    with torch.no_grad():
        e = _unit(_perpendicular(p - c, u))
        for _ in range(_NEWTON_STEPS):
            t, residual, slope = newton(e, c, u, r, p, d)
            step = (-residual / slope).clamp(-0.5, 0.5)
            e = step.cos() * e + step.sin() * t
    # The circle turns with its body: carry e along rigidly (perpendicular to u), then correct along the tangent.
    e = _unit(_perpendicular(e, u))
    t, residual, slope = newton(e, c, u, r, p, d)
    return e - residual / slope.detach() * t


def contacts_from_features(
    rows: Tensor, R_A: Tensor, p_A: Tensor, R_B: Tensor, p_B: Tensor
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Gap, normal and witness points of feature pairs; see `features.contact_from_features`.

    Args:
        rows: (..., 16), feature pairs; no gradient.
        R_A: (..., 3, 3), R_WA.
        p_A: (..., 3), p_WA, m.
        R_B: (..., 3, 3), R_WB; the identity for the floor.
        p_B: (..., 3), p_WB, m; zero for the floor.

    Returns:
        phi (...,), m; nhat_BA_W (..., 3); witness points on A and on B (..., 3), m, world frame.
    """
    kind_A, r_A = rows[..., 0:1], rows[..., 7:8]
    kind_B, r_B = rows[..., 8:9], rows[..., 15:16]
    pA = (R_A @ rows[..., 1:4, None])[..., 0] + p_A
    uA = (R_A @ rows[..., 4:7, None])[..., 0]
    pB = (R_B @ rows[..., 9:12, None])[..., 0] + p_B
    uB = (R_B @ rows[..., 12:15, None])[..., 0]
    circle_A, circle_B = kind_A == CIRCLE, kind_B == CIRCLE
    line_A, line_B = kind_A == LINE, kind_B == LINE
    plane_A, plane_B = kind_A == PLANE, kind_B == PLANE

    # Rims become points on them (sharp: no rounding radius).
    rim_A = torch.where(plane_B, -_unit(_perpendicular(uB, uA)), _unit(_perpendicular(pB - pA, uA)))
    rim_B = torch.where(plane_A, -_unit(_perpendicular(uA, uB)), _unit(_perpendicular(pA - pB, uB)))
    mixed_A, mixed_B = circle_A & line_B, circle_B & line_A
    if bool(mixed_A.any()):
        rim_A = torch.where(mixed_A, _circle_near_line(pA, uA, r_A, pB, uB), rim_A)
    if bool(mixed_B.any()):
        rim_B = torch.where(mixed_B, _circle_near_line(pB, uB, r_B, pA, uA), rim_B)
    core_A = torch.where(
        circle_A, pA + r_A * rim_A, torch.where(line_A & plane_B, _through_rim(pA, uA, pB, uB, r_B), pA)
    )
    core_B = torch.where(
        circle_B, pB + r_B * rim_B, torch.where(line_B & plane_A, _through_rim(pB, uB, pA, uA, r_A), pB)
    )
    zero = torch.zeros_like(r_A)
    round_A = torch.where(circle_A | plane_A, zero, r_A)
    round_B = torch.where(circle_B | plane_B, zero, r_B)

    # Direction of a line, or the tangent of a rim that meets one.
    along_A = torch.where(mixed_A, torch.linalg.cross(uA, rim_A), uA)
    along_B = torch.where(mixed_B, torch.linalg.cross(uB, rim_B), uB)
    crossing = (line_A & line_B) | mixed_A | mixed_B
    difference = core_A - core_B
    flat = torch.where(line_A, _perpendicular(difference, uA), difference)
    flat = torch.where(line_B, _perpendicular(difference, uB), flat)
    n = _unit(torch.where(crossing, torch.linalg.cross(along_A, along_B), flat))
    # Out of a cylinder a normal of its rim points between the radius and the axis.
    out_A, out_B = -_dot(n, rim_A + uA), _dot(n, rim_B + uB)
    outward = torch.where(mixed_A, out_A, torch.where(mixed_B, out_B, torch.ones_like(r_A)))
    n = torch.where(outward < 0.0, -n, n)
    n = torch.where(plane_B, uB, torch.where(plane_A, -uA, n))
    phi = _dot(n, difference) - round_A - round_B

    # The witness point is on the side that is a point; two lines solve for theirs.
    cosine = _dot(along_A, along_B)
    sine2 = torch.where(crossing, 1.0 - cosine**2, torch.ones_like(cosine))
    slide = (cosine * _dot(difference, along_B) - _dot(difference, along_A)) / sine2
    a_core = torch.where(line_A & line_B, core_A + slide * along_A, core_A)
    a = a_core - round_A * n
    b = core_B + round_B * n
    from_B = plane_A | (line_A & ~line_B & ~plane_B)
    a = torch.where(from_B, b + phi * n, a)
    b = a - phi * n
    return phi[..., 0], n, a, b


def tangent_frames(n: Tensor) -> Tensor:
    """Contact frames (..., 3, 3) with rows n, t1, t2; see `features.tangents`."""
    x = torch.tensor([1.0, 0.0, 0.0], dtype=n.dtype, device=n.device).expand_as(n)
    z = torch.tensor([0.0, 0.0, 1.0], dtype=n.dtype, device=n.device).expand_as(n)
    reference = torch.where(n[..., 2:3].abs() < 0.9, z, x)
    t1 = _unit(torch.linalg.cross(reference, n))
    return torch.stack([n, t1, torch.linalg.cross(n, t1)], -2)


__all__ = ["CIRCLE", "LINE", "PLANE", "POINT", "contacts_from_features", "tangent_frames"]
