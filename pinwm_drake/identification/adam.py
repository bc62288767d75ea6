# SPDX-License-Identifier: MIT
"""Adam on the rendering loss, through renderer and physics, for several guesses at once."""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from pinwm_drake.identification.image_loss import BLOCKS
from pinwm_drake.identification.problem import Problem

_BETAS, _EPSILON = (0.8, 0.97), 1e-12
# Learning rate at first, in units of z, and the share of it to which it falls.
_RATE, _LAST_RATE = 0.5, 0.1
# Share of the iterations during which the frames that count grow from the first quarter to all: a push amplifies
# errors, and late frames are no guide before the early ones are right.
_GROW = 0.6
# Independent measurements that one frame counts as, in the balance of images and prior: its pixels are many, but what
# is wrong with a renderer, a silhouette or a contact model is wrong in all of them alike. Four is a pose in the plane,
# and an outline.
MEASUREMENTS = 4.0


@dataclass
class AdamState:
    """State of a descent: everything that going on needs."""

    iteration: int  # Number of steps done
    z: Tensor  # (W, p), the guesses
    first: Tensor  # (W, p), Adam's first moment of the gradient
    second: Tensor  # (W, p), its second moment
    scale: float  # Mean square by which losses are divided
    best_loss: Tensor  # (W,), the lowest loss over all frames
    best_z: Tensor  # (W, p), the guess that had it

    @staticmethod
    def at(z: Tensor) -> "AdamState":
        """State of a descent before its first step, at guesses z (W, p)."""
        zero = torch.zeros_like(z)
        infinite = torch.full((len(z),), torch.inf, dtype=torch.float64)
        return AdamState(0, z.clone(), zero, zero.clone(), 0.0, infinite, z.clone())


def descend(
    problem: Problem, state: AdamState, *, iterations: int, report: Callable[[AdamState, Tensor], None]
) -> None:
    """Goes on from a state to the last iteration.

    Args:
        problem: The pushes to explain.
        state: State to begin with; changed in place.
        iterations: Steps in all.
        report: Called after each step with the state and the losses (W,) over all frames.
    """
    counts = [push.num_frames for push in problem.pushes]
    # The outline has no gradient here: its scale stays as it is, and its prior does not pull it away.
    moving = torch.tensor([unknown.name != "outline" for unknown in problem.coordinates.free])
    while state.iteration < iterations:
        done = state.iteration / iterations
        shown = min(1.0, 0.25 + 0.75 * done / _GROW)
        parts = [(shown * n - torch.arange(n, dtype=torch.float64)).clamp(0.0, 1.0) for n in counts]
        weights = torch.cat(parts)[:, None]
        z = state.z.clone().requires_grad_()
        frames = torch.cat(problem.frame_losses(z, BLOCKS))
        losses = frames.detach().mean(0)
        if state.scale == 0.0:
            state.scale = float(losses.min())
        better = losses < state.best_loss
        state.best_loss = torch.where(better, losses, state.best_loss)
        state.best_z = torch.where(better[:, None], state.z, state.best_z)
        weighted = (weights * frames).sum(0) / weights.sum() / state.scale
        alive = torch.isfinite(losses)
        total = weighted[alive].sum() + problem.coordinates.penalty(z).sum() * (2.0 / (MEASUREMENTS * sum(counts)))
        (gradient,) = torch.autograd.grad(total, z)
        gradient = torch.where(moving, gradient, 0.0)
        state.iteration += 1
        state.first = _BETAS[0] * state.first + (1.0 - _BETAS[0]) * gradient
        state.second = _BETAS[1] * state.second + (1.0 - _BETAS[1]) * gradient**2
        first = state.first / (1.0 - _BETAS[0] ** state.iteration)
        second = state.second / (1.0 - _BETAS[1] ** state.iteration)
        moved = state.z - _RATE * _LAST_RATE**done * first / (second.sqrt() + _EPSILON)
        # A guess without a solution goes half way back to where it was best.
        moved = torch.where(alive[:, None], moved, 0.5 * (state.z + state.best_z))
        state.z = problem.coordinates.clamp(moved)
        report(state, losses)
