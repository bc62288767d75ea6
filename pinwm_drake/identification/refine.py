# SPDX-License-Identifier: MIT
"""Refinement of a guess: unknowns of the model and corrections of its poses together, by repeated expansion.

Around the poses of the moment the images are quadratic in poses and outline (`expansion.py`), and the corrections that
the model's discrepancy calls for are integrated out of that (`discrepancy.py`). What is left depends on the unknowns by
the physics alone, which costs a thousandth of a rendering, and is minimised by Levenberg-Marquardt. The images are then
expanded anew.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import torch
from torch import Tensor

from pinwm_drake.identification.adam import MEASUREMENTS
from pinwm_drake.identification.discrepancy import Marginal, prior_root
from pinwm_drake.identification.expansion import Expansion, corrected, deviation, expand
from pinwm_drake.identification.problem import Explained, Problem
from pinwm_drake.spatial.poses import Pose
from pinwm_drake.twin.drift import DRIFTS, FINE_DRIFTS, chances

# Step of the differences by an unknown, in z. That is 1 to 2 %: pushes that begin or end within another time step make
# poses a sawtooth of theta below that.
STEP_Z = 0.06
_DAMPINGS = (0.1, 1.0, 10.0)
_FIRST_DAMPING, _MOST_DAMPING = 1e-2, 1e6
_INNER = 8
# A gain of the objective below this ends a search.
_LEAST_GAIN = 0.02
# Frames whose loss is larger than this many times the median count less (Student's t of this many degrees of freedom).
_DEGREES = 4.0
# Relative ridge of the poses that would explain a frame best, and the least share of its loss that is noise.
_RIDGE, _LEAST_NOISE = 0.01, 0.05
# Shares of a step that are tried until the images agree that it is one forward.
_SHARES = (1.0, 0.5, 0.2)


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
    def shares(self, z: Tensor) -> Tensor:
        """Probabilities (W, K) of each of `drift.DRIFTS`, given guesses z (W, p)."""
        return torch.softmax(self._likelihoods(z), -1)

    @torch.no_grad()
    def fine_shares(self, z: Tensor) -> Tensor:
        """Probabilities (K,) of each of `drift.FINE_DRIFTS`, given unknowns z (p,)."""
        total = chances(FINE_DRIFTS).log()
        for push in range(len(self.expansions)):
            u, _ = self.deviations(z[None], push)
            total = total - torch.cat([self.marginal(push, *one).loss(u) for one in FINE_DRIFTS])
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
                if gain < _LEAST_GAIN:
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


@dataclass(frozen=True, eq=False)
class Surrogate(Objective):
    """Objective of the unknowns without the renderer."""

    problem: Problem

    def marginal(self, push: int, walk: float, turn: float) -> Marginal:
        """Quadratic loss of a push; see `Objective`."""
        expansion, weight = self.expansions[push], weights_of(self.expansions)[push]
        times = torch.from_numpy(self.problem.pushes[push].forward.times)
        prior = prior_root(expansion.X_WO, times, self.problem.radius, walk, turn)
        return Marginal.of(weight[:, None] * expansion.gradient, weight[:, None, None] * expansion.curvature, prior)

    def deviations(self, z: Tensor, push: int) -> tuple[Tensor, Tensor]:
        """Deviations (W, 6n + 1) of guesses z (W, p) from the images' expansion of a push, and (W,) bool: solved."""
        values, expansion = self.problem.coordinates.values(z, push), self.expansions[push]
        X_WO, alive = self.problem.pushes[push].forward.shown(values)
        at = Pose(expansion.X_WO.q[:, None], expansion.X_WO.p[:, None])
        poses = deviation(X_WO, at).transpose(0, 1).reshape(len(z), -1)
        return torch.cat([poses, (values["outline"] / expansion.outline).log()[:, None]], -1), alive


@dataclass
class RefineState:
    """State of a refinement: everything that going on needs."""

    iteration: int  # Number of expansions done
    z: Tensor  # (p,), the guess
    corrections: Tensor  # Of all pushes together (n, 6): rotation vectors [rad] and positions [m]
    loss: float  # Mean squares of the images, mean over frames, at the corrected poses
    done: bool  # Whether it has ended

    @staticmethod
    def at(problem: Problem, z: Tensor) -> "RefineState":
        """State before the first expansion, at unknowns z (p,)."""
        n = sum(push.num_frames for push in problem.pushes)
        return RefineState(0, z, torch.zeros(n, 6, dtype=torch.float64), float("inf"), False)


@torch.no_grad()
def surrogate_at(problem: Problem, z: Tensor, corrections: Tensor) -> Surrogate | None:
    """Surrogate around the corrected poses of unknowns z (p,); None where the physics has no solution."""
    counts = [push.num_frames for push in problem.pushes]
    expansions = []
    for number, (push, d) in enumerate(zip(problem.pushes, corrections.split(counts), strict=True)):
        values = problem.coordinates.values(z[None], number)
        X, alive = push.forward.shown(values)
        if not bool(alive[0]):
            return None
        X_WO = corrected(Pose(X.q[:, 0], X.p[:, 0]), d)
        outline = values["outline"][0]
        expansions.append(
            expand(push.pictures, push.surfels, X_WO, outline, problem.radius, num_threads=problem.num_threads)
        )
    return Surrogate(problem, expansions)


def refine(
    problem: Problem, state: RefineState, *, iterations: int, report: Callable[[RefineState], None]
) -> tuple[RefineState, Surrogate | None]:
    """Goes on from a state until nothing is gained, or to the last expansion.

    Args:
        problem: The pushes to explain.
        state: State to begin with; changed in place.
        iterations: Expansions in all.
        report: Called after each expansion.

    Returns:
        The state at the end, and the surrogate around it; None where the physics has no solution there.
    """
    surrogate = surrogate_at(problem, state.z, state.corrections)
    while surrogate is not None and not state.done and state.iteration < iterations:
        state.iteration += 1
        state.loss = surrogate.loss
        before = float(surrogate.objective(state.z[None])[0])
        goal = surrogate.minimise(state.z)
        gain = before - float(surrogate.objective(goal[None])[0])
        weights, walk = weights_of(surrogate.expansions), surrogate.walk(goal)
        last = joint_loss(problem, state.z, state.corrections, surrogate.expansions, weights, walk)
        state.done = True
        for share in _SHARES:
            z = problem.coordinates.clamp(state.z + share * (goal - state.z))
            corrections = torch.cat(surrogate.corrections(z, walk))
            after = surrogate_at(problem, z, corrections)
            if after is None:
                continue
            if joint_loss(problem, z, corrections, after.expansions, weights, walk) < last + _LEAST_GAIN:
                state.z, state.corrections, surrogate = z, corrections, after
                state.done = gain < _LEAST_GAIN and share == 1.0
                break
        report(state)
    if surrogate is not None:
        state.loss = surrogate.loss
    return state, surrogate


def joint_loss(
    problem: Problem,
    z: Tensor,
    corrections: Tensor,
    expansions: Sequence[Expansion],
    weights: Sequence[Tensor],
    walk: int,
) -> float:
    """Objective of unknowns z (p,) and corrections (n, 6) together, by the images' losses at the corrected poses.

    Args:
        problem: The pushes.
        z: The unknowns.
        corrections: Of all pushes together.
        expansions: Images at the corrected poses, of each push.
        weights: (n,) of each push's frames, as `weights_of` gives them.
        walk: Number of one of `drift.DRIFTS`, for the corrections' prior.
    """
    counts = [push.num_frames for push in problem.pushes]
    total = float(problem.coordinates.penalty(z))
    for push, expansion, weight, d in zip(problem.pushes, expansions, weights, corrections.split(counts), strict=True):
        times = torch.from_numpy(push.forward.times)
        root = prior_root(expansion.X_WO, times, problem.radius, *DRIFTS[walk])
        white = torch.linalg.solve_triangular(root, d.reshape(-1, 1), upper=False)
        total += 0.5 * float((weight * expansion.loss).sum()) + 0.5 * float((white * white).sum())
    return total


def weights_of(expansions: Sequence[Expansion]) -> list[Tensor]:
    """Weights (n,) of each push's frames: what one is worth by the noise of all and by its own.

    The noise of a frame is what no pose near by would take away of its loss.
    """
    noises = [_noise(expansion) for expansion in expansions]
    usual = float(torch.cat(noises).median())
    return [MEASUREMENTS * (_DEGREES + 1.0) / (_DEGREES * usual + noise) for noise in noises]


def _noise(expansion: Expansion) -> Tensor:
    """Least losses (n,) of the quadratic models of the frames."""
    H, g = expansion.curvature, expansion.gradient
    ridge = _RIDGE * torch.diag_embed(H.diagonal(dim1=-2, dim2=-1) + 1e-12)
    gain = (g * torch.linalg.solve(H + ridge, g)).sum(-1)
    return torch.maximum(expansion.loss - gain, _LEAST_NOISE * expansion.loss)
