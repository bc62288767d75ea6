# SPDX-License-Identifier: MIT
"""Posterior of the unknowns as draws, and the estimates of a twin that follow from them."""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from pinwm_drake.identification.forward import inertia
from pinwm_drake.identification.pictures import spaced
from pinwm_drake.identification.unknowns import UNKNOWNS, Coordinates
from pinwm_drake.scene import Scene
from pinwm_drake.twin.drift import DRIFT, DRIFT_TURN, FINE_DRIFTS
from pinwm_drake.twin.twin import THETA, Draws, Estimate

_PRIOR_DRAWS = 4000
# Draws that a twin keeps.
KEPT = 400
# An estimate is identifiable where the images narrow its prior to less than half, and its standard deviation, by its
# value, is below this; where the value is zero, by this one of a quantity between 0 and 1.
_NARROWED, PRECISE, _ZERO = 0.5, 0.3, 0.1
_MASS_NOTE = "held: with a velocity-driven pusher only ratios to the mass are observable"
_RATIO_NOTE = "free beside the inertia: only their ratio is observable, so that the interval is that of the prior"
PRIOR_NOTE = "the video says little about it: the interval is mostly that of the prior"
_DRIFT_NOTE = "standard deviation of what no parameter explains, after a way of one metre"
_TURN_NOTE = "factor of that for the rim of an object that turns"
_MOMENTS = {"inertia_xx": ("yy", "zz"), "inertia_yy": ("xx", "zz"), "inertia_zz": ("xx", "yy")}


@dataclass(frozen=True, eq=False)
class Posterior:
    """Posterior of the free unknowns."""

    z: Tensor  # (p,), what stands for it
    draws: Tensor  # (N, p)
    kept: Tensor  # (m, p), at most `KEPT` of the draws, evenly spaced
    drifts: Tensor  # (m, 2), walk [m] and turn of each of these: see `twin/drift.py`

    @staticmethod
    def of(z: Tensor, draws: Tensor, shares: Tensor, generator: torch.Generator) -> "Posterior":
        """Return the posterior with draws (N, p), and the probability (K,) of each of `drift.FINE_DRIFTS`.

        The drift hardly depends on the other unknowns.
        """
        kept = draws[spaced(len(draws), KEPT)]
        chosen = torch.multinomial(shares, len(kept), replacement=True, generator=generator)
        return Posterior(z, draws, kept, torch.tensor(FINE_DRIFTS, dtype=torch.float64)[chosen])


def estimates(
    coordinates: Coordinates, posterior: Posterior, scene: Scene, mass: float, mass_known: bool, seed: int
) -> tuple[dict[str, Estimate], dict[str, Estimate]]:
    """Theta and nuisances with 95 % intervals.

    Args:
        coordinates: The unknowns.
        posterior: Draws of them.
        scene: Scene of the object, for its inertia.
        mass: Mass of the object for which inertias are given, kg.
        mass_known: Whether it was measured.
        seed: Seed of draws from the prior.

    Returns:
        Theta with the keys of `THETA`, and the nuisances by name; those of a push have its number after the name where
        there are several.
    """
    prior = coordinates.draw_prior(_PRIOR_DRAWS, torch.Generator().manual_seed(seed))
    at, after, before = (_quantities(coordinates, z, scene, mass) for z in (posterior.z[None], posterior.draws, prior))
    theta = {}
    for key, unit in THETA.items():
        sources = [f"moment_{name}" for name in _MOMENTS.get(key, ())] or [key]
        free = any(name in coordinates.names for name in sources)
        value = float(at[key][0])
        if not free:
            note = ("as the capture says" if mass_known else _MASS_NOTE) if key == "mass" else "held"
            theta[key] = Estimate(value, None, False, unit, note)
        elif key == "mass" and any(name.startswith("moment") for name in coordinates.names):
            theta[key] = Estimate(value, interval(before[key], value), False, unit, _RATIO_NOTE)
        else:
            theta[key] = _estimate(value, after[key], before[key], unit, physical=True)
    nuisance = {}
    for name in after:
        if name in THETA or name.startswith("moment_"):
            continue
        unit, value = UNKNOWNS[name.partition(".")[0]].unit, float(at[name][0])
        if name.partition(".")[0] not in {unknown.name for unknown in coordinates.free}:
            nuisance[name] = Estimate(value, None, False, unit, "held")
        else:
            nuisance[name] = _estimate(value, after[name], before[name], unit, physical=False)
    for name, unit, note, values in (
        (DRIFT, "m", _DRIFT_NOTE, posterior.drifts[:, 0].numpy()),
        (DRIFT_TURN, "1", _TURN_NOTE, posterior.drifts[:, 1].numpy()),
    ):
        nuisance[name] = Estimate(float(values.mean()), interval(values, float(values.mean())), True, unit, note)
    return theta, nuisance


def kept_draws(coordinates: Coordinates, posterior: Posterior, scene: Scene, mass: float) -> Draws:
    """Draws of theta and of the nuisances of the object, in physical units, as a twin keeps them."""
    values = _quantities(coordinates, posterior.kept, scene, mass)
    shared = [name for name in values if name in THETA or (name in UNKNOWNS and UNKNOWNS[name].shared)]
    names = [name for name in shared if not name.startswith("moment_")]
    columns = [values[name] for name in names] + list(posterior.drifts.numpy().T)
    return Draws([*names, DRIFT, DRIFT_TURN], np.stack(columns, -1))


def _quantities(coordinates: Coordinates, z: Tensor, scene: Scene, mass: float) -> dict[str, np.ndarray]:
    """Values (S,) of theta, of `UNKNOWNS` and of those of each push for draws z (S, p), by name."""
    values = coordinates.values(z)
    moments = inertia(scene, mass, values).diagonal(dim1=-2, dim2=-1)
    # The mass that inertias are given for is the nominal one, and moves with a free mass only by their ratio.
    values.update({f"inertia_{axis * 2}": moments[..., i] for i, axis in enumerate("xyz")})
    if coordinates.pushes > 1:
        own = [name for name in values if name in UNKNOWNS and not UNKNOWNS[name].shared]
        several = {
            f"{name}.{push}": coordinates.values(z, push)[name] for push in range(coordinates.pushes) for name in own
        }
        values = {name: value for name, value in values.items() if name not in own} | several
    return {name: value.numpy() for name, value in values.items()}


def interval(values: np.ndarray, value: float) -> tuple[float, float]:
    """95 % interval of draws (n,) that holds a value."""
    low, high = np.quantile(values, [0.025, 0.975])
    return min(float(low), value), max(float(high), value)


def _estimate(value: float, after: np.ndarray, before: np.ndarray, unit: str, *, physical: bool) -> Estimate:
    narrowed = float(after.std()) < _NARROWED * float(before.std())
    precise = not physical or float(after.std()) < PRECISE * (abs(value) or _ZERO)
    return Estimate(value, interval(after, value), bool(narrowed and precise), unit, "" if narrowed else PRIOR_NOTE)
