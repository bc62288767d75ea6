# SPDX-License-Identifier: MIT
"""Objective of the unknowns of an identification, by quadratic models of what the pushes show; its minimum."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import torch
from torch import Tensor

from pinwm_drake.identification.discrepancy import Marginal
from pinwm_drake.identification.expansion import Expansion
from pinwm_drake.identification.problem import Explained
from pinwm_drake.twin.drift import DRIFTS, FINE_DRIFTS, chances

# Step of the differences by an unknown, in z. That is 1 to 2 %: pushes that begin or end within another time step make
# poses a sawtooth of theta below that.
STEP_Z = 0.06
_DAMPINGS = (0.1, 1.0, 10.0)
_FIRST_DAMPING, _MOST_DAMPING = 1e-2, 1e6
_INNER = 8
# A gain of the objective below this ends a search.
LEAST_GAIN = 0.02


@dataclass(frozen=True, eq=False)
class Objective:
    """Objective of the unknowns by expansions: minus the logarithm of their posterior, up to a constant."""

    problem: Explained
    expansions: list[Expansion]  # Images, or measured poses, around poses, of each push

    @cached_property
    def marginals(self) -> list[list[Marginal]]:
        """Weighted, the corrections integrated out; of each push, one for each of `drift.DRIFTS`."""
        return [[self.marginal(push, *one) for one in DRIFTS] for push in range(len(self.expansions))]

    def marginal(self, push: int, walk: float, turn: float) -> Marginal:
        """Quadratic loss of a push, with the corrections of a drift integrated out."""
        raise NotImplementedError

    @property
    def loss(self) -> float:
        """Mean of the expansions' losses over frames: of images, mean squares."""
        return float(torch.cat([expansion.loss for expansion in self.expansions]).mean())

    def deviations(self, z: Tensor, push: int) -> tuple[Tensor, Tensor]:
        """Deviations (W, 6n + 1) of guesses z (W, p) from the expansion of a push, and (W,) bool: solved."""
        raise NotImplementedError

    @torch.no_grad()
    def objective(self, z: Tensor) -> Tensor:
        """Objective (W,) of guesses z (W, p); infinite where the physics found no solution."""
        return self.problem.coordinates.penalty(z) - torch.logsumexp(self._likelihoods(z), -1)

    @torch.no_grad()
    def ranked(self, guesses: Tensor) -> Tensor:
        """Those of the guesses (N, p) for which the physics has a solution, likeliest first."""
        values = self.objective(guesses)
        return guesses[torch.argsort(values, stable=True)[: int(torch.isfinite(values).sum())]]

    @torch.no_grad()
    def shares(self, z: Tensor) -> Tensor:
        """Probabilities (W, K) of each of `drift.DRIFTS`, given guesses z (W, p)."""
        return torch.softmax(self._likelihoods(z), -1)

    @torch.no_grad()
    def fine_shares(self, z: Tensor) -> Tensor:
        """Probabilities (K,) of each of `drift.FINE_DRIFTS`, by their evidence around unknowns z (p,).

        The unknowns are integrated out as Gaussians (Laplace): what they absorb of few pushes is no small drift.
        """
        coordinates = self.problem.coordinates
        slopes = [self._slopes(z, push) for push in range(len(self.expansions))]
        total = chances(FINE_DRIFTS).log()
        for k, one in enumerate(FINE_DRIFTS):
            A, g, loss = coordinates.precision.clone(), coordinates.precision @ z, coordinates.penalty(z)
            for push, (D, u) in enumerate(slopes):
                index, marginal = torch.tensor(coordinates.columns(push)), self.marginal(push, *one)
                A[index[:, None], index] += D @ marginal.A @ D.T
                g[index] += D @ (marginal.A @ u + marginal.b)
                loss = loss + marginal.loss(u[None])[0]
            root = torch.linalg.cholesky(A)
            gain = 0.5 * g @ torch.cholesky_solve(g[:, None], root)[:, 0]
            total[k] -= loss - gain + root.diagonal().log().sum()
        return torch.softmax(total, 0)

    def _likelihoods(self, z: Tensor) -> Tensor:
        """Logarithms (W, K) of the likelihood of guesses z (W, p) with each walk; minus infinite where unsolved."""
        found = [self.deviations(z, push) for push in range(len(self.marginals))]
        alive = torch.stack([alive for _, alive in found]).all(0)
        return torch.where(alive[:, None], self._weighed([u for u, _ in found]), -torch.inf)

    def _weighed(self, deviations: Sequence[Tensor]) -> Tensor:
        """Logarithms (W, K) of the likelihood of each walk, by the deviations (W, 6n + 1) of each push."""
        total = chances(DRIFTS).log().expand(len(deviations[0]), -1)
        for u, marginals in zip(deviations, self.marginals, strict=True):
            total = total - torch.stack([marginal.loss(u) for marginal in marginals], -1)
        return total

    @torch.no_grad()
    def quadratic(self, z: Tensor) -> tuple[Tensor, Tensor]:
        """Curvature (p, p) (Gauss-Newton) and gradient (p,) of the objective at z (p,), by differences."""
        coordinates = self.problem.coordinates
        A, g = coordinates.precision.clone(), coordinates.precision @ z
        slopes, middles = [], []
        for push in range(len(self.marginals)):
            D, u = self._slopes(z, push)
            slopes.append(D)
            middles.append(u)
        shares = torch.softmax(self._weighed([u[None] for u in middles]), -1)[0].nan_to_num().tolist()
        for push, (D, u, marginals) in enumerate(zip(slopes, middles, self.marginals, strict=True)):
            index = torch.tensor(coordinates.columns(push))
            for share, marginal in zip(shares, marginals, strict=True):
                A[index[:, None], index] += share * (D @ marginal.A @ D.T)
                g[index] += share * (D @ (marginal.A @ u + marginal.b))
        return A, g

    def _slopes(self, z: Tensor, push: int) -> tuple[Tensor, Tensor]:
        """Differences (m, 6n + 1) of a push's deviations by its unknowns, at z (p,), and the deviations there."""
        coordinates = self.problem.coordinates
        columns = coordinates.columns(push)
        m = len(columns)
        steps = STEP_Z * torch.eye(len(z), dtype=torch.float64)[columns]
        trial = coordinates.clamp(torch.cat([z[None], z + steps, z - steps]))
        u, alive = self.deviations(trial, push)
        # One-sided where a side has no solution; 0, as unobservable, where neither has.
        up = torch.where(alive[1 : m + 1], torch.arange(1, m + 1), 0)
        down = torch.where(alive[m + 1 :], torch.arange(m + 1, 2 * m + 1), 0)
        span = (trial[up] - trial[down])[torch.arange(m), columns]
        return torch.where(span[:, None] > 0.0, (u[up] - u[down]) / span.clamp_min(1e-9)[:, None], 0.0), u[0]

    @torch.no_grad()
    def minimise(self, z: Tensor, iterations: int = _INNER) -> Tensor:
        """Unknowns (p,) that minimise the objective, from z (p,) on, by Levenberg-Marquardt."""
        damping, best = _FIRST_DAMPING, float(self.objective(z[None])[0])
        model = None
        for _ in range(iterations):
            A, g = model = self.quadratic(z) if model is None else model
            dampings = torch.tensor([damping * factor for factor in _DAMPINGS], dtype=torch.float64)
            steps = torch.stack([torch.linalg.solve(A + k * torch.diag(A.diagonal()), -g) for k in dampings])
            trial = self.problem.coordinates.clamp(z + steps)
            values = self.objective(trial)
            first = int(values.argmin())
            if float(values[first]) < best:
                gain, best = best - float(values[first]), float(values[first])
                z, damping, model = trial[first], max(float(dampings[first]), 1e-6), None
                if gain < LEAST_GAIN:
                    break
            else:
                damping *= 30.0
                if damping > _MOST_DAMPING:
                    break
        return z

    def walk(self, z: Tensor) -> int:
        """Return the number of the likeliest of `drift.DRIFTS`, given unknowns z (p,)."""
        return int(self.shares(z[None])[0].argmax())

    def corrections(self, z: Tensor, walk: int) -> list[Tensor]:
        """Return likeliest corrections (n, 6) of each push's poses for unknowns z (p,) and a walk of `drift.DRIFTS`."""
        found = (self.deviations(z[None], push)[0][0] for push in range(len(self.marginals)))
        return [marginals[walk].corrections(u) for marginals, u in zip(self.marginals, found, strict=True)]
