"""Unknowns of an identification: physical parameters theta, and nuisances that every real video has.

Each unknown is held as a number z of order one: its physical value is `nominal + scale z`, or `nominal exp(scale z)`
for one that is positive. A Gaussian prior of zero mean keeps what the images say nothing about where it was.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from pinwm_drake.errors import ParameterError


@dataclass(frozen=True)
class Unknown:
    """Unknown number of an identification, its unit, prior and bounds.

    Attributes:
        name: Name in options and results.
        unit: Unit of its physical value; "1" for a pure number.
        positive: Whether it is positive and counts by its logarithm.
        nominal: Physical value at z = 0.
        scale: Change of the value (of its logarithm, where positive) that counts as one.
        prior: Standard deviation of the value (of its logarithm), before any image is seen.
        spread: Half the range (of the logarithm) from which random starts are drawn; 0 for nominal.
        low, high: Bounds of the value.
        physical: Whether it belongs to theta; a nuisance is of one video only.
    """

    name: str
    unit: str
    positive: bool
    nominal: float
    scale: float
    prior: float
    spread: float = 0.0
    low: float = -math.inf
    high: float = math.inf
    physical: bool = True


def _friction(name: str) -> Unknown:
    return Unknown(name, "1", True, 0.1, 0.3, 2.0, spread=math.log(7.0), low=1e-4, high=5.0)


def _moment(name: str) -> Unknown:
    return Unknown(name, "1", True, 1.0, 0.2, 0.2, low=0.05, high=20.0)


def _restitution(name: str) -> Unknown:
    return Unknown(name, "1", False, 0.0, 0.1, 0.5, low=0.0, high=1.0)


_DEGREE = math.pi / 180.0

# moment_* multiply the second moments of mass of a uniform solid along the axes of O, which covers only inertias of
# real bodies; lift raises object and floor over what the capture says; outline scales the object in the images about
# its middle there, as segmentation and anti-aliasing do, which else would be taken for a distance.
UNKNOWNS: dict[str, Unknown] = {
    unknown.name: unknown
    for unknown in (
        Unknown("mass", "kg", True, 1.0, 0.3, 2.0, spread=math.log(2.0), low=1e-4, high=1e3),
        _moment("moment_xx"),
        _moment("moment_yy"),
        _moment("moment_zz"),
        _friction("friction_floor"),
        _friction("friction_pusher"),
        _restitution("restitution_floor"),
        _restitution("restitution_pusher"),
        Unknown("start_x", "m", False, 0.0, 2e-3, 3e-3, physical=False),
        Unknown("start_y", "m", False, 0.0, 2e-3, 3e-3, physical=False),
        Unknown("start_yaw", "rad", False, 0.0, _DEGREE, 2.0 * _DEGREE, physical=False),
        Unknown("lift", "m", False, 0.0, 1e-3, 3e-3, physical=False),
        Unknown("time_offset", "s", False, 0.0, 5e-3, 2e-2, low=-0.2, high=0.2, physical=False),
        Unknown("outline", "1", True, 1.0, 0.01, 0.1, low=0.5, high=2.0, physical=False),
    )
}
# The object's own surface takes part in both contacts, so that, before any image is seen, its two frictions are alike:
# the standard deviation of the logarithm of their ratio.
_ALIKE = ("friction_pusher", "friction_floor", 0.7)
NUISANCES = tuple(name for name, unknown in UNKNOWNS.items() if not unknown.physical)
DEFAULT_FREE = ("friction_floor", "friction_pusher", "moment_xx", "moment_yy", *NUISANCES)


class Coordinates:
    """The free unknowns as a vector z, and the held ones as constants."""

    def __init__(self, free: Sequence[str], held: Mapping[str, float]) -> None:
        """Chooses the free unknowns and the values of the held ones.

        Args:
            free: Names of the free unknowns, each once.
            held: Physical values of others, by name; for a free one, the value at z = 0.

        Raises:
            ParameterError: An unknown name, none at all, one twice, or a value out of its bounds.
        """
        for name in (*free, *held):
            if name not in UNKNOWNS:
                raise ParameterError(f"{name!r} is no unknown; allowed: {', '.join(UNKNOWNS)}")
        if not free or len(set(free)) != len(free):
            raise ParameterError(f"free unknowns are {list(free)}; allowed: one or more, each once")
        for name, value in held.items():
            unknown = UNKNOWNS[name]
            low = max(unknown.low, 0.0) if unknown.positive else unknown.low
            if not (math.isfinite(value) and low <= value <= unknown.high) or (unknown.positive and value == 0.0):
                raise ParameterError(f"{name} is held at {value}; allowed: {low:g} to {unknown.high:g} {unknown.unit}")
        self.free = [UNKNOWNS[name] for name in UNKNOWNS if name in free]
        self.names = [unknown.name for unknown in self.free]
        self.centre = {name: float(held.get(name, unknown.nominal)) for name, unknown in UNKNOWNS.items()}
        prior = [unknown.prior / unknown.scale for unknown in self.free]
        self.precision = torch.diag(torch.tensor([1.0 / value**2 for value in prior], dtype=torch.float64))
        self._couple(*_ALIKE)
        bounds = [self._bounds(unknown) for unknown in self.free]
        self.low, self.high = torch.tensor(bounds, dtype=torch.float64).unbind(-1)

    def _couple(self, first: str, second: str, deviation: float) -> None:
        """Adds to the prior that the logarithms of two unknowns differ as at z = 0, to a standard deviation."""
        if first not in self.names or second not in self.names:
            return
        row = torch.zeros(len(self.free), dtype=torch.float64)
        row[self.names.index(first)] = UNKNOWNS[first].scale / deviation
        row[self.names.index(second)] = -UNKNOWNS[second].scale / deviation
        self.precision = self.precision + torch.outer(row, row)

    def _bounds(self, unknown: Unknown) -> tuple[float, float]:
        """Bounds of the number z that stands for an unknown."""
        centre = self.centre[unknown.name]

        def z_of(value: float) -> float:
            return (math.log(value / centre) if unknown.positive else value - centre) / unknown.scale

        return (
            z_of(unknown.low) if math.isfinite(unknown.low) else -math.inf,
            z_of(unknown.high) if math.isfinite(unknown.high) else math.inf,
        )

    def __len__(self) -> int:
        """Number of free unknowns."""
        return len(self.free)

    def values(self, z: Tensor) -> dict[str, Tensor]:
        """Physical values of all unknowns, free and held.

        Args:
            z: (..., p).

        Returns:
            (...) for each name; differentiable in z.
        """
        values = {name: z.new_full(z.shape[:-1], centre) for name, centre in self.centre.items()}
        for column, unknown in enumerate(self.free):
            change = unknown.scale * z[..., column]
            centre = self.centre[unknown.name]
            values[unknown.name] = centre * change.exp() if unknown.positive else centre + change
        return values

    def clamp(self, z: Tensor) -> Tensor:
        """The nearest z within the bounds."""
        return torch.minimum(torch.maximum(z, self.low), self.high)

    def draw(self, number: int, generator: torch.Generator) -> Tensor:
        """Random starts (number, p), uniform within each unknown's spread; the first is the centre."""
        spread = torch.tensor([unknown.spread / unknown.scale for unknown in self.free], dtype=torch.float64)
        z = (2.0 * torch.rand(number, len(self), generator=generator, dtype=torch.float64) - 1.0) * spread
        z[0] = 0.0
        return self.clamp(z)

    def penalty(self, z: Tensor) -> Tensor:
        """Minus the logarithm of the prior, (...), up to a constant."""
        return 0.5 * (z * (z @ self.precision)).sum(-1)
