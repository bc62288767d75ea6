"""The step's mixed LCP as dense torch matrices, and its differentiable solution.

    A x - H' z = p,      s = H x + B z + b >= 0  perpendicular to  z >= 0

with x = [xi'; lambda_e], z the rows [lambda_n, lambda_1..k, gamma] of each contact, A = [M, -J_e'; J_e, eps_e I] and
B = [eps, 0, 0; 0, eps I, 1; mu, -1', 0] per contact. Everything is written out; nothing is eliminated. This is the
oracle of `kernels/lcp.py`.

Source: PIN-WM eq. 8-9; Cline (2002), eq. 4.24.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

# As in the kernels: violations below this, relative to the step's scales, are rounding.
SIGN_TOLERANCE = 1e-12
_CORRECTIONS = 10


@dataclass(frozen=True, eq=False)
class MixedLcp:
    """Mixed LCPs of W worlds, one per world.

    Attributes:
        A: (W, n, n).
        p: (W, n).
        H: (W, N, n), N = C (k + 2).
        B: (W, N, N).
        b: (W, N).
        impulse: (W, 1), impulse scale, N s.
        speed: (W, 1), speed scale, m/s.
        is_speed: (N,), True where the row's slack is a speed and its multiplier an impulse (normal and friction rows).
    """

    A: Tensor
    p: Tensor
    H: Tensor
    B: Tensor
    b: Tensor
    impulse: Tensor
    speed: Tensor
    is_speed: Tensor

    @property
    def s_scale(self) -> Tensor:
        """Scale (W, N) of each slack."""
        return torch.where(self.is_speed, self.speed, self.impulse)

    @property
    def z_scale(self) -> Tensor:
        """Scale (W, N) of each multiplier."""
        return torch.where(self.is_speed, self.impulse, self.speed)

    def detach(self) -> "MixedLcp":
        """Problem with the same numbers, cut from the graph that autograd keeps."""
        return MixedLcp(*(getattr(self, name).detach() for name in self.__dataclass_fields__))

    def slack(self, x: Tensor, z: Tensor) -> Tensor:
        """Slacks s (W, N) at x (W, n) and z (W, N)."""
        return (self.H @ x[..., None] + self.B @ z[..., None])[..., 0] + self.b

    def standard_form(self) -> tuple[Tensor, Tensor]:
        """Standard form s = matrix z + vector, with x eliminated: matrix (W, N, N) and vector (W, N)."""
        solved = torch.linalg.solve(self.A, torch.cat([self.H.mT, self.p[..., None]], -1))
        return self.H @ solved[..., :-1] + self.B, (self.H @ solved[..., -1:])[..., 0] + self.b


def solve_on_active_set(lcp: MixedLcp, active: Tensor) -> tuple[Tensor, Tensor]:
    """Solution x, z of the LCP whose active rows (W, N) have zero slack and whose other rows have zero multiplier.

    It is one linear solve, so autograd through it is the implicit function theorem with the transposed KKT matrix.
    """
    n = lcp.A.shape[-1]
    on = active[..., None].to(lcp.A.dtype)
    eye = torch.eye(lcp.b.shape[-1], dtype=lcp.A.dtype, device=lcp.A.device)
    top = torch.cat([lcp.A, -lcp.H.mT], -1)
    bottom = torch.cat([on * lcp.H, on * lcp.B + (1.0 - on) * eye], -1)
    right = torch.cat([lcp.p, -active.to(lcp.b.dtype) * lcp.b], -1)
    solution = torch.linalg.solve(torch.cat([top, bottom], -2), right[..., None])[..., 0]
    return solution[..., :n], solution[..., n:]


def admissible(active: Tensor, k: int) -> Tensor:
    """Drops rows that an open contact, or one without a loaded friction direction, leaves undetermined."""
    rows = active.unflatten(-1, (-1, k + 2))
    normal = rows[..., :1]
    friction = rows[..., 1 : k + 1] & normal
    gamma = rows[..., k + 1 :] & normal & friction.any(-1, keepdim=True)
    return torch.cat([normal, friction, gamma], -1).flatten(-2)


def settle(lcp: MixedLcp, active: Tensor, k: int) -> tuple[Tensor, Tensor]:
    """Corrects an active set (W, N) by the signs of its solution until all inequalities hold.

    Returns:
        The active set, and which worlds (W,) are settled.
    """
    W = active.shape[0]
    for _ in range(_CORRECTIONS):
        active = admissible(active, k)
        x, z = solve_on_active_set(lcp, active)
        s = lcp.slack(x, z)
        keep = z >= -SIGN_TOLERANCE * lcp.z_scale
        join = s < -SIGN_TOLERANCE * lcp.s_scale
        flipped = admissible(torch.where(active, keep, join), k)
        # Rows of open contacts other than their normal row do not count: their gamma is free.
        wrong = (flipped != active).reshape(W, -1)
        if not bool(wrong.any()):
            break
        active = torch.where(wrong.any(-1, keepdim=True), flipped, active)
    return active, ~wrong.any(-1)
