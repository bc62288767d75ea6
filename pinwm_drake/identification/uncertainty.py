"""Uncertainty of the estimates: a Gaussian around the optimum, and its intervals in physical units.

The Gauss-Newton curvature of the rendering loss is the Fisher information of independent Gaussian pixels. Pixels of a
video are far from independent: the same outline is wrong in the same way in frame after frame. So the information is
divided by a dispersion, the ratio of the scores' scatter over blocks of frames to the scatter that the curvature
predicts (a quasi-likelihood).

Source: McCullagh and Nelder, Generalized Linear Models, section 9.2; Bishop, Pattern Recognition and Machine Learning,
    section 4.4, for the Laplace approximation.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from pinwm_drake.identification.forward import inertia
from pinwm_drake.identification.gauss_newton import Quadratic, objective
from pinwm_drake.identification.pictures import Pictures
from pinwm_drake.identification.problem import Problem
from pinwm_drake.identification.unknowns import Coordinates
from pinwm_drake.scene import Scene
from pinwm_drake.twin.twin import Estimate

_BLOCK = 4  # frames
_SAMPLES = 4000
# An estimate is identifiable where the images narrow its prior to less than half, and its relative standard deviation
# is below this.
_NARROWED, _PRECISE = 0.5, 0.3
# Steps of the profile, in standard deviations, and the 95 % quantiles of the normal distribution and half chi squared.
_STEPS, _TWO_SIDED, _RISE = (2.0, 4.0, 8.0, 16.0), 1.96, 1.92
_FARTHEST = 32.0
_MASS_NOTE = "held: with a velocity-driven pusher only ratios to the mass are observable"
_RATIO_NOTE = "free beside the inertia: only their ratio is observable, so that the interval is that of the prior"
_HELD_NOTE = "held"


@dataclass(frozen=True, eq=False)
class Posterior:
    """Gaussian over the free unknowns, and its reach where the likelihood is not Gaussian.

    Attributes:
        z: (p,), its mean.
        covariance: (p, p).
        dispersion: Number by which the information of the images was divided.
        reach: (p, 2), by how many standard deviations each unknown can go down and up until the images contradict
            it (95 %), where that is more than the Gaussian has; infinite where they never do.
    """

    z: Tensor
    covariance: Tensor
    dispersion: float
    reach: Tensor


def laplace(coordinates: Coordinates, model: Quadratic, z: Tensor, weight: float) -> Posterior:
    """The Gaussian around an optimum.

    Args:
        coordinates: The unknowns.
        model: Quadratic model of the loss at z.
        z: (p,).
        weight: Factor of a frame's mean squares.
    """
    information = weight * model.curvature.sum(0)
    P = coordinates.precision
    scores = weight * (model.gradient - model.gradient.mean(0))
    pad = (-len(scores)) % _BLOCK
    sums = torch.cat([scores, scores.new_zeros(pad, scores.shape[1])]).reshape(-1, _BLOCK, scores.shape[1]).sum(1)
    inverse = torch.linalg.inv(information + P)
    effective = float(torch.trace(inverse @ information))
    # Images without noise are no reason to count them for more than they were.
    dispersion = max(float(torch.trace(inverse @ sums.T @ sums)) / max(effective, 1e-9), 1.0)
    covariance = torch.linalg.inv(information / dispersion + P)
    return Posterior(z, 0.5 * (covariance + covariance.T), dispersion, torch.full((len(z), 2), _TWO_SIDED))


@torch.no_grad()
def profile(problem: Problem, pictures: Pictures, posterior: Posterior, weight: float) -> Posterior:
    """Widens the Gaussian where the likelihood is flat.

    An object that never slides ahead of the pusher, for one, bounds its friction on the floor from below only. Every
    physical unknown is moved down and up, alone and with the others following as the Gaussian says, until twice the
    logarithm of the likelihood has fallen by the 95 % quantile of chi squared with one degree of freedom.

    Args:
        problem: The episode to explain, with poses in the frames of `pictures`.
        pictures: The pictures to explain.
        posterior: Result of `laplace`.
        weight: Factor of a frame's mean squares in the objective, for these frames.

    Returns:
        The same with its `reach`.
    """
    z, covariance, coordinates = posterior.z, posterior.covariance, problem.coordinates
    best = objective(problem, weight, problem.frame_losses(pictures, z[None], (1,))[:, 0], z)
    reach = posterior.reach.clone()
    for i, unknown in enumerate(coordinates.free):
        if not unknown.physical:
            continue
        sigma = float(covariance[i, i].sqrt())
        alone = torch.zeros_like(z)
        alone[i] = sigma
        for side, sign in enumerate((-1.0, 1.0)):
            steps = [sign * k * way for k in _STEPS for way in (alone, covariance[:, i] / sigma)]
            trial = coordinates.clamp(z + torch.stack(steps))
            losses = problem.frame_losses(pictures, trial, (1,))
            rise = torch.tensor(
                [objective(problem, weight, losses[:, row], trial[row]) - best for row in range(len(trial))]
            ).reshape(len(_STEPS), 2)
            reach[i, side] = max(_crossing(rise.amin(1)), _TWO_SIDED)
    return replace(posterior, reach=reach)


def _crossing(rise: Tensor) -> float:
    """Number of standard deviations at which the objective has risen by 1.92; infinite where it never has."""
    before_k, before = 0.0, 0.0
    for k, value in zip(_STEPS, rise.tolist(), strict=True):
        if value >= _RISE:
            # In between it rises as a parabola does.
            share = (_RISE - before) / (value - before) if math.isfinite(value) else 1.0
            return before_k + (k - before_k) * max(share, 0.0) ** 0.5
        before_k, before = k, max(value, 0.0)
    return math.inf


def estimates(
    coordinates: Coordinates, posterior: Posterior, scene: Scene, mass: float, mass_known: bool, seed: int
) -> tuple[dict[str, Estimate], dict[str, Estimate]]:
    """Theta and nuisances with intervals, from draws of the Gaussian.

    Args:
        coordinates: The unknowns.
        posterior: Gaussian around the optimum.
        scene: Scene of the object, for its inertia.
        mass: Mass of the object for which inertias are given, kg.
        mass_known: Whether it was measured.
        seed: Seed of the draws.

    Returns:
        Theta with the keys of `THETA`, and the nuisances by name.
    """
    generator = torch.Generator().manual_seed(seed)
    p = len(coordinates)
    noise = torch.randn(_SAMPLES, p, generator=generator, dtype=torch.float64)
    values, vectors = torch.linalg.eigh(posterior.covariance)
    root = vectors * values.clamp_min(0.0).sqrt()
    offsets = noise @ root.T
    # Each side of each unknown is stretched as far as the likelihood reaches there.
    stretch = torch.where(offsets < 0.0, posterior.reach[:, 0], posterior.reach[:, 1]).clamp_max(_FARTHEST) / _TWO_SIDED
    draws = coordinates.clamp(posterior.z + stretch * offsets)
    open_ended = {
        name: (math.isinf(posterior.reach[i, 0]), math.isinf(posterior.reach[i, 1]))
        for i, name in enumerate(coordinates.names)
    }
    before = coordinates.clamp(noise @ torch.linalg.cholesky(torch.linalg.inv(coordinates.precision)).T)
    at, after, prior = (_quantities(coordinates, z, scene, mass) for z in (posterior.z[None], draws, before))
    moments = {"inertia_xx": ("xx", 1, 2), "inertia_yy": ("yy", 0, 2), "inertia_zz": ("zz", 0, 1)}
    names = ("moment_xx", "moment_yy", "moment_zz")
    found = {}
    for key, (unit, physical) in _KEYS.items():
        sources = [names[i] for i in moments[key][1:]] if key in moments else [key]
        free = any(name in coordinates.names for name in sources)
        if key == "mass" and not free:
            note = "as the capture says" if mass_known else _MASS_NOTE
            found[key] = (physical, Estimate(float(at[key][0]), None, False, unit, note))
        elif key == "mass" and any(name in coordinates.names for name in names):
            low, high = np.quantile(prior[key], [0.025, 0.975])
            ends = (min(float(low), float(at[key][0])), max(float(high), float(at[key][0])))
            found[key] = (physical, Estimate(float(at[key][0]), ends, False, unit, _RATIO_NOTE))
        elif not free:
            found[key] = (physical, Estimate(float(at[key][0]), None, False, unit, _HELD_NOTE))
        else:
            ends = open_ended.get(key, (False, False))
            found[key] = (physical, _estimate(at[key], after[key], prior[key], unit, physical, ends))
    theta = {key: estimate for key, (physical, estimate) in found.items() if physical}
    nuisance = {key: estimate for key, (physical, estimate) in found.items() if not physical}
    return theta, nuisance


_KEYS = {
    "mass": ("kg", True),
    "inertia_xx": ("kg m^2", True),
    "inertia_yy": ("kg m^2", True),
    "inertia_zz": ("kg m^2", True),
    "friction_floor": ("1", True),
    "friction_pusher": ("1", True),
    "restitution_floor": ("1", True),
    "restitution_pusher": ("1", True),
    "start_x": ("m", False),
    "start_y": ("m", False),
    "start_yaw": ("rad", False),
    "lift": ("m", False),
    "time_offset": ("s", False),
    "outline": ("1", False),
}


def _quantities(coordinates: Coordinates, z: Tensor, scene: Scene, mass: float) -> dict[str, np.ndarray]:
    """Values of all quantities of `_KEYS` for draws z (S, p): (S,) each."""
    values = coordinates.values(z)
    moments = inertia(scene, mass, values).diagonal(dim1=-2, dim2=-1)
    values.update({f"inertia_{axis * 2}": moments[..., i] for i, axis in enumerate("xyz")})
    return {key: values[key].numpy() for key in _KEYS}


def _estimate(
    at: np.ndarray, after: np.ndarray, prior: np.ndarray, unit: str, physical: bool, open_ended: tuple[bool, bool]
) -> Estimate:
    value = float(at[0])
    low, high = np.quantile(after, [0.025, 0.975])
    if any(open_ended):
        note = "the video bounds it from above only" if open_ended[0] else "the video bounds it from below only"
        note = "the video says nothing about it" if all(open_ended) else note
        before = np.quantile(prior, [0.025, 0.975])
        low, high = (
            min(low, before[0]) if open_ended[0] else low,
            max(high, before[1]) if open_ended[1] else high,
        )
        return Estimate(value, (min(float(low), value), max(float(high), value)), False, unit, note)
    narrowed = float(after.std()) < _NARROWED * float(prior.std())
    precise = not physical or float(after.std()) < _PRECISE * max(abs(value), 0.3 if value == 0.0 else 0.0)
    note = "" if narrowed else "the video says little about it: the interval is mostly that of the prior"
    return Estimate(value, (min(float(low), value), max(float(high), value)), bool(narrowed and precise), unit, note)
