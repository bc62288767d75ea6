# SPDX-License-Identifier: MIT
"""The equations of a step with its contacts as dense torch matrices, and their differentiable solution.

    A x - H - sum_c J_c' f_c(J_c x + bias_c) = 0

with x = [xi'; lambda_e] and A = [M, -J_e'; J_e, eps_e I]. Everything is written out; nothing is eliminated. This is the
oracle of `kernels/cone.py`, and it is solved in another way: friction has bounds that are given, which makes a step
the minimum of a convex function, and these are iterated until they are those of the normal impulses.

Source: PIN-WM eq. 8-9, with Coulomb's cone in place of its polyhedron; Haslinger (1983) for the iteration.
"""

from dataclasses import dataclass, replace

import torch
from torch import Tensor

_ROUNDS, _STEPS, _HALVINGS, _POLISHES = 60, 60, 50, 12
# Residual, relative to the step's impulse, of a solution.
_SMALL = 1e-10
# Slope at the minimum along a step, relative to the one at its start.
_FLAT = 1e-6


@dataclass(frozen=True, eq=False)
class ContactProblem:
    """Steps of W worlds with C contacts, one per world."""

    A: Tensor  # (W, n, n)
    p: Tensor  # (W, n)
    J: Tensor  # (W, C, 3, n), zero for what is no contact
    bias: Tensor  # (W, C, 3), m/s
    mu: Tensor  # (W, C), friction coefficients
    limit: Tensor  # (W, C), largest normal impulses, N s
    compliance: float  # eps, (m/s)/(N s)
    impulse: Tensor  # (W,), impulse scale, N s

    def detach(self) -> "ContactProblem":
        """Problem with the same numbers, cut from the graph that autograd keeps."""
        names = ("A", "p", "J", "bias", "mu", "limit", "impulse")
        return replace(self, **{name: getattr(self, name).detach() for name in names})

    def velocity(self, x: Tensor) -> Tensor:
        """Velocities v (W, C, 3) of the contacts in their frames at x (W, n)."""
        return (self.J @ x[:, None, :, None])[..., 0] + self.bias

    def contact_impulse(self, v: Tensor, radius: Tensor | None = None) -> Tensor:
        """Impulses (W, C, 3) at velocities v (W, C, 3); friction is bounded by radius (W, C), else by the cone."""
        normal = torch.minimum((-v[..., 0] / self.compliance).clamp_min(0.0), self.limit)
        most = self.mu * normal if radius is None else radius
        speed = v[..., 1:].square().sum(-1)
        speed = torch.where(speed > 0.0, speed, torch.ones_like(speed)).sqrt()
        moves = (v[..., 1:] != 0.0).any(-1)
        sliding = moves & (speed > self.compliance * most)
        scale = torch.where(sliding, most / speed, torch.full_like(most, 1.0 / self.compliance))
        return torch.cat([normal[..., None], -v[..., 1:] * scale[..., None]], -1)

    def residual(self, x: Tensor, radius: Tensor | None = None) -> Tensor:
        """Residual (W, n) of the step's equations at x (W, n)."""
        impulse = self.contact_impulse(self.velocity(x), radius)
        return (self.A @ x[..., None])[..., 0] - self.p - (self.J.mT @ impulse[..., None])[..., 0].sum(1)

    def derivative(self, x: Tensor, radius: Tensor | None = None) -> Tensor:
        """Return the derivative (W, n, n) of the residual at x (W, n)."""
        v = self.velocity(x)
        gain = -_slope(self, v, radius)
        return self.A + (self.J.mT @ gain @ self.J).sum(1)


def _slope(problem: ContactProblem, v: Tensor, radius: Tensor | None) -> Tensor:
    """Return the derivative (W, C, 3, 3) of the impulses with respect to v."""
    normal, stuck = -v[..., 0] / problem.compliance, 1.0 / problem.compliance
    bounded = normal.clamp_min(0.0).minimum(problem.limit)
    by_normal = torch.where((normal >= 0.0) & (normal < problem.limit), -stuck, torch.zeros_like(normal))
    most = problem.mu * bounded if radius is None else radius
    speed = v[..., 1:].norm(dim=-1)
    slides = (speed > 0.0) & (speed > problem.compliance * most)
    along = v[..., 1:] / torch.where(slides, speed, torch.ones_like(speed))[..., None]
    gain = torch.zeros(*v.shape, 3, dtype=v.dtype, device=v.device)
    gain[..., 0, 0] = by_normal
    eye = torch.eye(2, dtype=v.dtype, device=v.device)
    across = (most / torch.where(slides, speed, torch.ones_like(speed)))[..., None, None]
    sliding = -across * (eye - along[..., :, None] * along[..., None, :])
    gain[..., 1:, 1:] = torch.where(slides[..., None, None], sliding, -stuck * eye)
    if radius is None:
        by_cone = torch.where(slides, problem.mu * by_normal, torch.zeros_like(normal))
        gain[..., 1:, 0] = -by_cone[..., None] * along
    return gain


def _descend(problem: ContactProblem, x: Tensor, radius: Tensor) -> Tensor:
    """Minimum x (W, n) for bounds of friction (W, C), by Newton's method with a bisection along each step."""
    for _ in range(_STEPS):
        residual = problem.residual(x, radius)
        if bool((residual.abs().amax(-1) <= _SMALL * problem.impulse).all()):
            break
        step = -torch.linalg.solve(problem.derivative(x, radius), residual)
        start = (residual * step).sum(-1, keepdim=True)
        low = torch.zeros(len(x), 1, dtype=x.dtype, device=x.device)
        high = torch.ones_like(low)
        for _ in range(_HALVINGS):
            share = high if _ == 0 else 0.5 * (low + high)
            slope = (problem.residual(x + share * step, radius) * step).sum(-1, keepdim=True)
            # A slope of rounding's size is the minimum's.
            past = slope > _FLAT * start.abs()
            low, high = torch.where(past, low, share), torch.where(past, share, high)
            if bool((low == high).all()):
                break
        x = x + high * step
    return x


def _polish(problem: ContactProblem, x: Tensor) -> Tensor:
    """Solution near x (W, n), by Newton's method on the equations with their cones."""
    for _ in range(_POLISHES):
        residual = problem.residual(x)
        x = x - torch.linalg.solve(problem.derivative(x), residual)
        if bool((residual.abs().amax(-1) <= _SMALL * problem.impulse).all()):
            break  # this step leaves no more than rounding
    return x


def _error(problem: ContactProblem, x: Tensor) -> Tensor:
    """Residual (W,) relative to the impulse scale; infinite where it is not a number."""
    error = problem.residual(x).abs().amax(-1) / problem.impulse
    return torch.where(error.isfinite(), error, torch.full_like(error, torch.inf))


def solve(problem: ContactProblem, start: Tensor) -> tuple[Tensor, Tensor]:
    """Differentiable solution x (W, n) of the equations, and which worlds (W,) have one.

    It is found without gradient; a last step of Newton's method, whose derivative is held, is the implicit function
    theorem to autograd.

    Args:
        problem: one per world.
        start: (W, n), usually the velocity without contacts.
    """
    with torch.no_grad():
        held = problem.detach()
        x, radius = start, torch.zeros_like(held.mu)
        best, error = start, _error(held, start)
        for _ in range(_ROUNDS):
            x = _descend(held, x, radius)
            polished = _polish(held, x)
            found = _error(held, polished)
            better = found < error
            best, error = torch.where(better[:, None], polished, best), torch.where(better, found, error)
            if bool((error <= _SMALL).all()):
                break
            radius = held.mu * held.contact_impulse(held.velocity(x), radius)[..., 0]
        S = held.derivative(best)
    return best - torch.linalg.solve(S, problem.residual(best)), error <= _SMALL
