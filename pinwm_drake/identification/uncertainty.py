"""How sure an estimate is: a Gaussian around the optimum, and what it means in physical units.

The Gauss-Newton curvature of the rendering loss is the Fisher information of independent Gaussian pixels. Pixels of a
video are far from independent: the same outline is wrong in the same way in frame after frame. So the information is
divided by a dispersion, the ratio of the scores' scatter over blocks of frames to the scatter that the curvature
predicts (a quasi-likelihood).

Source: McCullagh and Nelder, Generalized Linear Models, section 9.2; Bishop, Pattern Recognition and Machine Learning,
    section 4.4, for the Laplace approximation.
"""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from pinwm_drake.identification.forward import inertia
from pinwm_drake.identification.gauss_newton import Quadratic
from pinwm_drake.identification.unknowns import Coordinates
from pinwm_drake.scene import Scene
from pinwm_drake.twin.twin import Estimate

_BLOCK = 4  # frames
_SAMPLES = 4000
# An estimate is identifiable where the images narrow its prior to less than half, and its relative standard deviation
# is below this.
_NARROWED, _PRECISE = 0.5, 0.3
_MASS_NOTE = "held: with a velocity-driven pusher only ratios to the mass are observable"
_HELD_NOTE = "held"


@dataclass(frozen=True, eq=False)
class Posterior:
    """A Gaussian over the free unknowns.

    Attributes:
        z: (p,), its mean.
        covariance: (p, p).
        dispersion: By which the information of the images was divided.
    """

    z: Tensor
    covariance: Tensor
    dispersion: float


def laplace(coordinates: Coordinates, model: Quadratic, z: Tensor, weight: float) -> Posterior:
    """The Gaussian around an optimum.

    Args:
        coordinates: The unknowns.
        model: Of the loss at z.
        z: (p,).
        weight: What a frame's mean squares were multiplied with.
    """
    information = weight * model.curvature.sum(0)
    P = torch.diag(coordinates.precision)
    scores = weight * (model.gradient - model.gradient.mean(0))
    pad = (-len(scores)) % _BLOCK
    sums = torch.cat([scores, scores.new_zeros(pad, scores.shape[1])]).reshape(-1, _BLOCK, scores.shape[1]).sum(1)
    inverse = torch.linalg.inv(information + P)
    effective = float(torch.trace(inverse @ information))
    dispersion = max(float(torch.trace(inverse @ sums.T @ sums)) / max(effective, 1e-9), 1e-6)
    covariance = torch.linalg.inv(information / dispersion + P)
    return Posterior(z, 0.5 * (covariance + covariance.T), dispersion)


def estimates(
    coordinates: Coordinates, posterior: Posterior, scene: Scene, mass: float, mass_known: bool, seed: int
) -> tuple[dict[str, Estimate], dict[str, Estimate]]:
    """Theta and nuisances with intervals, from draws of the Gaussian.

    Args:
        coordinates: The unknowns.
        posterior: Around the optimum.
        scene: Of the object, for its inertia.
        mass: With which inertias count, kg.
        mass_known: Whether it was measured.
        seed: Of the draws.

    Returns:
        Theta with the keys of `THETA`, and the nuisances by name.
    """
    generator = torch.Generator().manual_seed(seed)
    p = len(coordinates)
    noise = torch.randn(_SAMPLES, p, generator=generator, dtype=torch.float64)
    values, vectors = torch.linalg.eigh(posterior.covariance)
    root = vectors * values.clamp_min(0.0).sqrt()
    draws = coordinates.clamp(posterior.z + noise @ root.T)
    before = coordinates.clamp(noise * coordinates.precision.rsqrt())
    at, after, prior = (_quantities(coordinates, z, scene, mass) for z in (posterior.z[None], draws, before))
    moments = {"inertia_xx": ("xx", 1, 2), "inertia_yy": ("yy", 0, 2), "inertia_zz": ("zz", 0, 1)}
    names = ("moment_xx", "moment_yy", "moment_zz")
    found = {}
    for key, (unit, physical) in _KEYS.items():
        sources = [names[i] for i in moments[key][1:]] if key in moments else [key]  # type: ignore[misc]
        free = any(name in coordinates.names for name in sources)
        if key == "mass" and not free:
            note = "as the capture says" if mass_known else _MASS_NOTE
            found[key] = (physical, Estimate(float(at[key][0]), None, False, unit, note))
        elif not free:
            found[key] = (physical, Estimate(float(at[key][0]), None, False, unit, _HELD_NOTE))
        else:
            found[key] = (physical, _estimate(at[key], after[key], prior[key], unit, physical))
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


def _estimate(at: np.ndarray, after: np.ndarray, prior: np.ndarray, unit: str, physical: bool) -> Estimate:
    low, high = np.quantile(after, [0.025, 0.975])
    value = float(at[0])
    narrowed = float(after.std()) < _NARROWED * float(prior.std())
    precise = not physical or float(after.std()) < _PRECISE * max(abs(value), 0.3 if value == 0.0 else 0.0)
    note = "" if narrowed else "the video says little about it: the interval is mostly that of the prior"
    return Estimate(value, (min(float(low), value), max(float(high), value)), bool(narrowed and precise), unit, note)
