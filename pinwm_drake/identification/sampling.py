# SPDX-License-Identifier: MIT
"""Draws from a posterior whose density is cheap: an ensemble of walkers that begins with draws of Gaussians.

Source: ter Braak and Vrugt, "Differential evolution Markov chain with snooker updater and fewer chains", Statistics and
    Computing 18, 2008; Nelson, Ford and Payne, "RUN DMC", ApJS 210, 2014, for its moves by halves of the ensemble.
"""

from collections.abc import Callable

import torch
from torch import Tensor

# Walkers; half of them move at once, along differences of the others.
WALKERS = 96
# Draws of the Gaussian of which the walkers are chosen, for each of them, and its degrees of freedom as a Student's t.
_CHOICE, _DEGREES = 4, 6.0
# Logarithm of the density where there is none, for a share of it.
_NOTHING = 1e12
# Precision of the power that evens out weights.
_EVEN = 1e-3
# Relative spread of a move's length, and every how many moves a long one goes from mode to mode.
_JITTER, _JUMP = 0.2, 10


@torch.no_grad()
def sample(
    objective: Callable[[Tensor], Tensor],
    means: Tensor,
    covariances: Tensor,
    clamp: Callable[[Tensor], Tensor],
    generator: torch.Generator,
    *,
    moves: int,
    report: Callable[[float], None] = lambda share: None,
) -> tuple[Tensor, Tensor]:
    """Draws from a density exp(-objective).

    Args:
        objective: Function of (W, p), minus the logarithm of the density (W,), infinite where it is zero.
        means: (K, p), of Gaussians near the density, one for each of its modes.
        covariances: (K, p, p), of them.
        clamp: Function that brings (W, p) within bounds.
        generator: Source of randomness.
        moves: Moves of every walker; those of the second half are kept.
        report: Called after each move with the share of them that is done.

    Returns:
        (N, p) draws, and their objectives (N,).
    """
    p = means.shape[1]
    values, vectors = torch.linalg.eigh(covariances)
    values = values.clamp_min(1e-16)
    roots = vectors * values.sqrt()[:, None]
    evidence = 0.5 * values.log().sum(-1) - objective(means)
    starts = [
        _start(objective, mean, root, clamp, generator, count)
        for mean, root, count in zip(means, roots, _shares_of(evidence), strict=True)
        if count
    ]
    z, energy = (torch.cat(parts) for parts in zip(*starts, strict=True))
    order = torch.randperm(WALKERS, generator=generator)
    z, energy = z[order], energy[order]
    kept, energies = [], []
    half = WALKERS // 2
    length = 2.38 / (2.0 * p) ** 0.5
    for move in range(moves):
        for first in (0, half):
            moving, others = torch.arange(first, first + half), torch.arange(half - first, 2 * half - first)
            pick = torch.rand(half, half, generator=generator).argsort(-1)[:, :2]
            way = z[others[pick[:, 0]]] - z[others[pick[:, 1]]]
            scale = length * (1.0 + _JITTER * torch.randn(half, 1, generator=generator, dtype=torch.float64))
            if move % _JUMP == _JUMP - 1:
                scale = torch.ones_like(scale)
            noise = 1e-3 * torch.randn(half, p, generator=generator, dtype=torch.float64) @ roots[0].T
            trial = z[moving] + scale * way + noise
            allowed = (clamp(trial) == trial).all(-1)
            there = torch.where(allowed, objective(clamp(trial)), torch.inf)
            accept = torch.rand(half, generator=generator, dtype=torch.float64).log() < energy[moving] - there
            z[moving] = torch.where(accept[:, None], trial, z[moving])
            energy[moving] = torch.where(accept, there, energy[moving])
        if move >= moves // 2:
            kept.append(z.clone())
            energies.append(energy.clone())
        report((move + 1) / moves)
    return torch.cat(kept), torch.cat(energies)


def _shares_of(evidence: Tensor) -> list[int]:
    """Walkers of each mode, `WALKERS` in all, by the logarithms (K,) of how much of the density they hold (Laplace)."""
    shares = torch.softmax(evidence.nan_to_num(neginf=-_NOTHING), 0)
    ends = (WALKERS * shares.cumsum(0)).round().int()
    return torch.diff(ends, prepend=torch.zeros(1, dtype=torch.int32)).tolist()


def _start(
    objective: Callable[[Tensor], Tensor],
    mean: Tensor,
    root: Tensor,
    clamp: Callable[[Tensor], Tensor],
    generator: torch.Generator,
    count: int,
) -> tuple[Tensor, Tensor]:
    """Where walkers of a mode begin (count, p), and the objectives there, of its mean (p,) and a root (p, p)."""
    number, p = _CHOICE * count, len(mean)
    normal = torch.randn(number, p, generator=generator, dtype=torch.float64)
    chi = torch.randn(number, int(_DEGREES), generator=generator, dtype=torch.float64).square().sum(-1) / _DEGREES
    normal = normal / chi.sqrt()[:, None]
    normal[0] = 0.0
    drawn = clamp(mean + normal @ root.T)
    found = objective(drawn)
    gain = 0.5 * (_DEGREES + p) * torch.log1p(normal.square().sum(-1) / _DEGREES) - found
    chosen = _spread(torch.nan_to_num(gain, nan=-torch.inf), count, generator)
    return drawn[chosen], found[chosen]


def _spread(gain: Tensor, count: int, generator: torch.Generator) -> Tensor:
    """Return indices (count,) of draws by their weights exp(gain) (N,), evened out until that many of them count.

    Few draws with all of the weight would be no start for walkers, which move along their differences.
    """
    low, high = 0.0, 1.0
    if _effective(gain) >= count:
        low = 1.0
    while low < 1.0 and high - low > _EVEN:
        power = 0.5 * (low + high)
        low, high = (power, high) if _effective(power * gain) >= count else (low, power)
    shares = torch.softmax(torch.where(torch.isfinite(gain), low * gain, -torch.inf), 0).cumsum(0)
    steps = torch.arange(count) + torch.rand(1, generator=generator, dtype=torch.float64)
    chosen = torch.searchsorted(shares, steps / count * shares[-1]).clamp_max(len(gain) - 1)
    return chosen[torch.randperm(count, generator=generator)]


def _effective(gain: Tensor) -> float:
    """Effective number of draws of weights exp(gain) (N,)."""
    return float(1.0 / torch.softmax(gain, 0).square().sum())
