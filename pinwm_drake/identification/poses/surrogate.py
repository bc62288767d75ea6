# SPDX-License-Identifier: MIT
"""Objective of the shared unknowns, given measured poses: what is of one push alone is integrated out.

The pose that was measured in frame k is that of the model with the correction of `discrepancy.py` and white noise. The
unknowns of one push, such as its start, clock and frictions, move the model's poses nearly linearly: they join the
correction, with a covariance J C J' of their slopes J and priors C. What is left to search are the unknowns of the
object and of the frame, however many pushes there are.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from pinwm_drake.identification.discrepancy import Marginal, prior_root
from pinwm_drake.identification.expansion import Expansion, deviation
from pinwm_drake.identification.forward import Forward
from pinwm_drake.identification.objective import STEP_Z, Objective
from pinwm_drake.identification.problem import Explained
from pinwm_drake.identification.unknowns import Coordinates
from pinwm_drake.spatial.poses import Pose
from pinwm_drake.twin.drift import DRIFTS
from pinwm_drake.twin.kicks import Kicks

# Relative, of a covariance's diagonal: keeps it positive.
_RIDGE = 1e-9


@dataclass(frozen=True, eq=False)
class PosedEpisode:
    """One push: the physics that is to explain its measured poses."""

    forward: Forward
    measured: Pose  # q (n, 4), p (n, 3) [m], world
    seen: Tensor  # (6,) bool: which of rotation and position, world axes, were measured

    @property
    def num_frames(self) -> int:
        """Number of poses n."""
        return len(self.measured.p)

    def deviations(self, values: dict[str, Tensor]) -> tuple[Tensor, Tensor]:
        """Deviations (W, n, 6) of the model's poses from the measured ones [rad; m], and (W,) bool: solved."""
        X_WO, alive = self.forward.poses(values)
        return deviation(X_WO, Pose(self.measured.q[:, None], self.measured.p[:, None])).transpose(0, 1), alive


@dataclass(frozen=True, eq=False)
class PosedProblem(Explained):
    """Model that is to explain measured poses: unknowns that the pushes share, and those of each."""

    pushes: tuple[PosedEpisode, ...]
    own: Coordinates | None  # Unknowns of one push, with their priors; None where they are all held

    def values(self, z: Tensor, own: Tensor) -> dict[str, Tensor]:
        """Physical values (W,) of all unknowns, for shared ones z (W, p) and those of a push (W, m)."""
        shared = self.coordinates.values(z)
        if self.own is None:
            return shared
        of_push = self.own.values(own)
        return shared | {unknown.name: of_push[unknown.name] for unknown in self.own.free}


@dataclass(frozen=True, eq=False)
class PoseSurrogate(Objective):
    """Objective of the shared unknowns; see the module's text."""

    problem: PosedProblem
    at: list[Tensor]  # Unknowns (m,) of each push about which its poses are taken for linear
    slopes: list[Tensor]  # (6n, m), by the unknowns of each push
    precision: Tensor  # (6,), inverse variances of the white noise
    carried: list[Kicks]  # Of each push, see `Forward.kicks`

    def marginal(self, push: int, walk: float, turn: float) -> Marginal:
        """Quadratic loss of a push; see `Objective`."""
        expansion, J, own = self.expansions[push], self.slopes[push], self.problem.own
        K = self._covariance(push, walk, turn)
        if own is not None:
            K = K + J @ torch.linalg.solve(own.precision, J.T)
        root = torch.linalg.cholesky(K + _RIDGE * torch.diag(K.diagonal()))
        return Marginal.of(expansion.gradient, expansion.curvature, root)

    def _covariance(self, push: int, walk: float, turn: float) -> Tensor:
        """Covariance (6n, 6n) of the corrections of a push with a drift."""
        one = self.problem.pushes[push]
        times = torch.from_numpy(one.forward.times)
        root = prior_root(one.measured, times, self.problem.radius, walk, turn, self.carried[push])
        return root @ root.T

    def deviations(self, z: Tensor, push: int) -> tuple[Tensor, Tensor]:
        """Deviations (W, 6n + 1) of guesses z (W, p) with the likeliest a priori unknowns of a push; (W,) solved."""
        own = self.at[push]
        d, alive = self.problem.pushes[push].deviations(self.problem.values(z, own.expand(len(z), -1)))
        u = d.reshape(len(z), -1) - self.slopes[push] @ own
        return torch.nn.functional.pad(u, (0, 1)), alive

    @torch.no_grad()
    def joint(self, z: Tensor, owns: Sequence[Tensor], walk: int) -> float:
        """Objective of shared unknowns z (p,) and those (m,) of each push together, with nothing taken for linear.

        It counts how wide the corrections are, so that surrogates about different poses compare.
        """
        total = float(self.problem.coordinates.penalty(z))
        for push, (one, own) in enumerate(zip(self.problem.pushes, owns, strict=True)):
            d, alive = one.deviations(self.problem.values(z[None], own[None]))
            if not bool(alive[0]):
                return math.inf
            rows, S = self._seen(push, walk)
            root = torch.linalg.cholesky(S)
            white = torch.linalg.solve_triangular(root, d.reshape(-1, 1)[rows], upper=False)
            total += 0.5 * float(white.square().sum()) + float(root.diagonal().log().sum())
            if self.problem.own is not None:
                total += float(self.problem.own.penalty(own))
        return total

    def _seen(self, push: int, walk: int) -> tuple[Tensor, Tensor]:
        """Rows of deviations (6n,) that were measured, and the covariance of corrections and noise among them."""
        one = self.problem.pushes[push]
        rows = one.seen.repeat(one.num_frames)
        noise = torch.diag((1.0 / self.precision.clamp_min(1e-12)).repeat(one.num_frames))
        return rows, (self._covariance(push, *DRIFTS[walk]) + noise)[rows][:, rows]

    @torch.no_grad()
    def own(self, z: Tensor, push: int, walk: int) -> tuple[Tensor, Tensor]:
        """Mean (m,) and covariance (m, m) of the unknowns of a push, given the shared ones z (p,) and a drift."""
        J, own = self.slopes[push], self.problem.own
        assert own is not None
        C = torch.linalg.inv(own.precision)
        rows, S = self._seen(push, walk)
        J = J[rows]
        u, _ = self.deviations(z[None], push)
        gain = C @ J.T @ torch.linalg.inv(J @ C @ J.T + S)
        return -gain @ u[0, :-1][rows], C - gain @ J @ C


def _steps(own: Coordinates | None) -> Tensor:
    """Half of the span (m,) in z over which slopes by the unknowns of a push are taken.

    A pusher that slips or sticks makes kinks, and so the slope by its friction is that over the spread of its prior.
    """
    if own is None:
        return torch.zeros(0, dtype=torch.float64)
    given = zip(own.free, own.deviations, strict=True)
    spans = [prior / unknown.scale if unknown.name == "grip_pusher" else STEP_Z for unknown, prior in given]
    return torch.tensor(spans, dtype=torch.float64)


@torch.no_grad()
def pose_surrogate(problem: PosedProblem, z: Tensor, at: list[Tensor], sigma: Tensor) -> PoseSurrogate | None:
    """Surrogate about shared unknowns z (p,) and those (m,) of each push; None where the physics has no solution.

    The noise is white, of standard deviations sigma (6,) [rad; m].
    """
    precision = 1.0 / sigma.square()
    expansions, slopes, carried = [], [], []
    for one, own in zip(problem.pushes, at, strict=True):
        m, n = len(own), one.num_frames
        steps = torch.diag(_steps(problem.own))
        guesses = torch.cat([own[None], own + steps, own - steps])
        if problem.own is not None:
            guesses = problem.own.clamp(guesses)
        d, alive = one.deviations(problem.values(z.expand(len(guesses), -1), guesses))
        if not bool(alive[0]):
            return None
        span = (guesses[1 : m + 1] - guesses[m + 1 :]).diagonal()
        change = (d[1 : m + 1] - d[m + 1 :]).reshape(m, -1) / span.clamp_min(1e-9)[:, None]
        both = alive[1 : m + 1] & alive[m + 1 :] & (span > 0.0)
        J = torch.where(both[:, None], change, 0.0).T
        curvature = torch.diag(torch.nn.functional.pad(torch.where(one.seen, precision, 0.0), (0, 1)))
        size = (d[0] * one.seen / _radii(problem.radius)).square().sum(-1)
        outline = torch.ones((), dtype=torch.float64)
        expansion = Expansion(
            one.measured, outline, size, torch.zeros(n, 7, dtype=torch.float64), curvature.expand(n, 7, 7)
        )
        expansions.append(expansion)
        slopes.append(J)
        carried.append(one.forward.kicks(problem.values(z[None], own[None])))
    return PoseSurrogate(problem, expansions, at, slopes, precision, carried)


def _radii(radius: float) -> Tensor:
    """Sizes (6,) by which rotations and positions count as shares of the object's radius."""
    return torch.tensor([1.0, 1.0, 1.0, radius, radius, radius], dtype=torch.float64)
