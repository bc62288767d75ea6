# SPDX-License-Identifier: MIT
"""Refinement of a guess: unknowns of the model and corrections of its poses together, by repeated expansion.

Around the poses of the moment the images are quadratic in poses and outline (`expansion.py`), and the corrections that
the model's discrepancy calls for are integrated out of that (`discrepancy.py`). What is left depends on the unknowns by
the physics alone, which costs a thousandth of a rendering, and is minimised by Levenberg-Marquardt. The images are then
expanded anew.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import torch
from torch import Tensor

from pinwm_drake.identification.adam import MEASUREMENTS
from pinwm_drake.identification.discrepancy import Marginal, prior_root
from pinwm_drake.identification.expansion import Expansion, corrected, deviation, expand
from pinwm_drake.identification.objective import LEAST_GAIN, Objective
from pinwm_drake.identification.problem import Problem
from pinwm_drake.spatial.poses import Pose
from pinwm_drake.twin.drift import DRIFTS
from pinwm_drake.twin.kicks import Kicks

# Frames whose loss is larger than this many times the median count less (Student's t of this many degrees of freedom).
_DEGREES = 4.0
# Relative ridge of the poses that would explain a frame best, and the least share of its loss that is noise.
_RIDGE, _LEAST_NOISE = 0.01, 0.05
# Shares of a step that are tried until the images agree that it is one forward.
_SHARES = (1.0, 0.5, 0.2)


@dataclass(frozen=True, eq=False)
class Surrogate(Objective):
    """Objective of the unknowns without the renderer."""

    problem: Problem
    carried: list[Kicks]  # Of each push, see `Forward.kicks`

    @cached_property
    def weights(self) -> list[Tensor]:
        """Weights (n,) of the frames of each push."""
        return weights_of(self.expansions)

    def marginal(self, push: int, walk: float, turn: float) -> Marginal:
        """Quadratic loss of a push; see `Objective`."""
        expansion, weight = self.expansions[push], self.weights[push]
        times = torch.from_numpy(self.problem.pushes[push].forward.times)
        prior = prior_root(expansion.X_WO, times, self.problem.radius, walk, turn, self.carried[push])
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
def surrogate_at(
    problem: Problem, z: Tensor, corrections: Tensor, kicks: list[Kicks] | None = None
) -> Surrogate | None:
    """Surrogate around the corrected poses of unknowns z (p,); None where the physics has no solution.

    Kicks of each push may be those of unknowns near by; None for those of z.
    """
    counts = [push.num_frames for push in problem.pushes]
    expansions, carried = [], list(kicks or [])
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
        if kicks is None:
            carried.append(push.forward.kicks(values))
    return Surrogate(problem, expansions, carried)


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
        weights, walk = surrogate.weights, surrogate.walk(goal)
        last = joint_loss(surrogate, state.z, state.corrections, weights, walk)
        state.done = True
        for share in _SHARES:
            z = problem.coordinates.clamp(state.z + share * (goal - state.z))
            corrections = torch.cat(surrogate.corrections(z, walk))
            after = surrogate_at(problem, z, corrections, surrogate.carried)
            if after is None:
                continue
            if joint_loss(after, z, corrections, weights, walk) < last + LEAST_GAIN:
                state.z, state.corrections, surrogate = z, corrections, after
                state.done = gain < LEAST_GAIN and share == 1.0
                break
        report(state)
    if surrogate is not None:
        state.loss = surrogate.loss
        values = (problem.coordinates.values(state.z[None], number) for number in range(len(problem.pushes)))
        carried = [push.forward.kicks(one) for push, one in zip(problem.pushes, values, strict=True)]
        surrogate = replace(surrogate, carried=carried)
    return state, surrogate


def joint_loss(surrogate: Surrogate, z: Tensor, corrections: Tensor, weights: Sequence[Tensor], walk: int) -> float:
    """Objective of unknowns z (p,) and corrections (n, 6) together, by the images' losses at the corrected poses.

    Args:
        surrogate: Images at the corrected poses.
        z: The unknowns.
        corrections: Of all pushes together.
        weights: (n,) of each push's frames, as `weights_of` gives them.
        walk: Number of one of `drift.DRIFTS`, for the corrections' prior.
    """
    problem = surrogate.problem
    counts = [push.num_frames for push in problem.pushes]
    total = float(problem.coordinates.penalty(z))
    of = zip(problem.pushes, surrogate.expansions, surrogate.carried, weights, corrections.split(counts), strict=True)
    for push, expansion, carried, weight, d in of:
        times = torch.from_numpy(push.forward.times)
        root = prior_root(expansion.X_WO, times, problem.radius, *DRIFTS[walk], carried)
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
