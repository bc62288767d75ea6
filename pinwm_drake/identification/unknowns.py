# SPDX-License-Identifier: MIT
"""Unknowns of an identification: physical parameters theta, and nuisances that every real video has.

Each unknown is held as a number z of order one: its physical value is `nominal + scale z`, or `nominal exp(scale z)`
for one that is positive. A Gaussian prior of zero mean keeps what the images say nothing about where it was. Theta and
some nuisances belong to the object, and are shared by all pushes; the others are of one push, and come once for each.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from pinwm_drake.errors import ParameterError
from pinwm_drake.twin.drift import GRIPS


@dataclass(frozen=True)
class Unknown:
    """Unknown number of an identification, its unit, prior and bounds."""

    name: str  # Name in options and results
    unit: str  # Unit of its physical value; "1" for a pure number
    positive: bool  # Whether it is positive and counts by its logarithm
    nominal: float  # Physical value at z = 0
    scale: float  # Change of the value (of its logarithm, where positive) that counts as one
    prior: float  # Standard deviation of the value (of its logarithm), before any image is seen
    spread: float = 0.0  # Half the range of random starts (of the logarithm, where positive); 0 for nominal
    low: float = -math.inf  # Lower bound of the value
    high: float = math.inf  # Upper bound
    physical: bool = True  # Whether it belongs to theta; else it is a nuisance
    shared: bool = True  # Whether it belongs to the object; else to a push


BODIES = ("floor", "pusher")
_DEGREE = math.pi / 180.0

# moment_* multiply the second moments of mass of a uniform solid along the axes of O, which covers only inertias of
# real bodies; support_* spread the pressure on the face that the object rests on along them, against a uniform one;
# center_* move the centre of mass; contact_offset is by how much larger object and pusher act together than their
# meshes; grip_* are by how much a push's frictions differ from the object's, as they do from place to place and from
# one law of contact to another; frame_* move the pusher's log in the world of the object, see `twin/frame.py`; lift
# raises object and floor over what the capture says; view_* move what the camera
# of a push shows against the world of the pusher, as a camera that is calibrated wrongly does; outline scales the
# object in the images about its middle there, as segmentation and anti-aliasing do, which else would be taken for a
# distance.
UNKNOWNS: dict[str, Unknown] = {
    unknown.name: unknown
    for unknown in (
        Unknown("mass", "kg", True, 1.0, 0.3, 2.0, spread=math.log(2.0), low=1e-4, high=1e3),
        *(Unknown(f"moment_{axis}", "1", True, 1.0, 0.1, 0.1, low=0.05, high=20.0) for axis in ("xx", "yy", "zz")),
        *(
            Unknown(f"friction_{body}", "1", True, 0.2, 0.2, 1.0, spread=math.log(6.0), low=1e-4, high=5.0)
            for body in BODIES
        ),
        *(Unknown(f"restitution_{body}", "1", False, 0.0, 0.1, 0.2, spread=0.4, low=0.0, high=1.0) for body in BODIES),
        *(Unknown(f"support_{axis}", "1", True, 1.15, 0.2, 0.3, low=0.15, high=3.0, physical=False) for axis in "xyz"),
        *(Unknown(f"center_{axis}", "m", False, 0.0, 1e-3, 1e-3, low=-0.2, high=0.2, physical=False) for axis in "xyz"),
        Unknown("contact_offset", "m", False, 0.0, 5e-4, 1e-3, low=-0.02, high=0.02, physical=False),
        *(Unknown(f"frame_{axis}", "m", False, 0.0, 1e-3, 1.5e-3, low=-0.1, high=0.1, physical=False) for axis in "xy"),
        Unknown("frame_yaw", "rad", False, 0.0, _DEGREE, 0.5 * _DEGREE, low=-0.5, high=0.5, physical=False),
        Unknown("lift", "m", False, 0.0, 1e-3, 3e-3, physical=False),
        *(Unknown(f"start_{axis}", "m", False, 0.0, 2e-3, 1e-3, physical=False, shared=False) for axis in "xy"),
        Unknown("start_yaw", "rad", False, 0.0, _DEGREE, 3.0 * _DEGREE, physical=False, shared=False),
        Unknown("time_offset", "s", False, 0.0, 5e-3, 2e-2, low=-0.2, high=0.2, physical=False, shared=False),
        *(
            Unknown(f"grip_{body}", "1", True, 1.0, prior, prior, low=0.5, high=2.0, physical=False, shared=False)
            for body, prior in ((body, GRIPS[f"friction_{body}"]) for body in BODIES)
        ),
        *(Unknown(f"view_{axis}", "m", False, 0.0, 1e-3, 5e-4, physical=False, shared=False) for axis in "xyz"),
        Unknown("outline", "1", True, 1.0, 0.01, 0.1, low=0.5, high=2.0, physical=False, shared=False),
    )
}
# Pairs whose logarithms are alike before any image is seen, and the standard deviation of their ratio's logarithm: the
# object's own surface takes part in both contacts, and a face that carries at its rim does so all around.
_ALIKE = (
    ("friction_pusher", "friction_floor", 1.5),
    ("support_x", "support_y", 0.15),
    ("support_y", "support_z", 0.15),
    ("support_z", "support_x", 0.15),
)
NUISANCES = tuple(name for name, unknown in UNKNOWNS.items() if not unknown.physical)
DEFAULT_FREE = ("friction_floor", "friction_pusher", "restitution_pusher", "moment_xx", "moment_yy", *NUISANCES)


def _told(unknown: Unknown, deviations: Mapping[str, float]) -> Unknown:
    """Unknown with scale, prior and random starts of the standard deviation that is told of it, where that is wider.

    It is the centre of mass alone that a search has to begin with far from its nominal value.
    """
    deviation = deviations.get(unknown.name, 0.0)
    if not unknown.name.startswith("center_") or deviation <= unknown.prior:
        return unknown
    return replace(unknown, scale=deviation, prior=deviation, spread=deviation)


class Coordinates:
    """The free unknowns as a vector z, and the held ones as constants.

    The columns of z are the free unknowns of the object in the order of `UNKNOWNS`, then those of the first push, of
    the second, and so on. `one_sided` (p,) bool are those that cannot be less than their nominal value.
    """

    def __init__(
        self,
        free: Sequence[str],
        held: Mapping[str, float],
        pushes: int = 1,
        priors: Sequence[Mapping[str, float]] = (),
        shared: Mapping[str, float] | None = None,
    ) -> None:
        """Chooses the free unknowns and the values of the held ones.

        Args:
            free: Names of the free unknowns, each once.
            held: Physical values of others, by name; for a free one, the value at z = 0.
            pushes: Number of pushes.
            priors: Standard deviations of some unknowns of each push, by name, in the place of their own; none for all.
            shared: Standard deviations of some unknowns of the object, likewise; None for none.

        Raises:
            ParameterError: An unknown name, none at all, one twice, or a value out of its bounds.
        """
        for name in (*free, *held):
            if name not in UNKNOWNS:
                raise ParameterError(f"unknown: got {name!r}; allowed: {', '.join(UNKNOWNS)}")
        if not free or len(set(free)) != len(free):
            raise ParameterError(f"free: got {list(free)}; allowed: one or more unknowns, each once")
        for name, value in held.items():
            unknown = UNKNOWNS[name]
            low = max(unknown.low, 0.0) if unknown.positive else unknown.low
            if not (math.isfinite(value) and low <= value <= unknown.high) or (unknown.positive and value == 0.0):
                raise ParameterError(
                    f"{name}: got {value} to be held at; allowed: {low:g} to {unknown.high:g} {unknown.unit}"
                )
        self.pushes = pushes
        common = [_told(UNKNOWNS[name], shared or {}) for name in UNKNOWNS if name in free and UNKNOWNS[name].shared]
        own = [UNKNOWNS[name] for name in UNKNOWNS if name in free and not UNKNOWNS[name].shared]
        self.free = common + own * pushes
        self.push = [-1] * len(common) + [push for push in range(pushes) for _ in own]
        self.names = [
            unknown.name if push < 0 or pushes == 1 else f"{unknown.name}.{push}"
            for unknown, push in zip(self.free, self.push, strict=True)
        ]
        self.centre = {name: float(held.get(name, unknown.nominal)) for name, unknown in UNKNOWNS.items()}
        told: list[Mapping[str, float]] = [shared or {}, *(priors or [{}] * pushes)]
        own_priors = [told[1 + push] for push in self.push]
        given = zip(self.free, own_priors, strict=True)
        self.deviations = [other.get(unknown.name, unknown.prior) for unknown, other in given]
        prior = [deviation / unknown.scale for unknown, deviation in zip(self.free, self.deviations, strict=True)]
        self.precision = torch.diag(torch.tensor([1.0 / value**2 for value in prior], dtype=torch.float64))
        for first, second, deviation in _ALIKE:
            self._couple(first, second, deviation)
        bounds = [[self._z_of(unknown, value) for value in (unknown.low, unknown.high)] for unknown in self.free]
        self.low, self.high = torch.tensor(bounds, dtype=torch.float64).unbind(-1)
        self.one_sided = torch.tensor([unknown.low == unknown.nominal for unknown in self.free])

    def _couple(self, first: str, second: str, deviation: float) -> None:
        """Add to the prior that the logarithms of two unknowns differ as at z = 0, to a standard deviation."""
        if first not in self.names or second not in self.names:
            return
        row = torch.zeros(len(self.free), dtype=torch.float64)
        row[self.names.index(first)] = UNKNOWNS[first].scale / deviation
        row[self.names.index(second)] = -UNKNOWNS[second].scale / deviation
        self.precision = self.precision + torch.outer(row, row)

    def _z_of(self, unknown: Unknown, value: float) -> float:
        centre = self.centre[unknown.name]
        return (math.log(value / centre) if unknown.positive else value - centre) / unknown.scale

    def __len__(self) -> int:
        """Return the number of free unknowns, with those of every push."""
        return len(self.free)

    def columns(self, push: int) -> list[int]:
        """Columns of z that a push depends on."""
        return [column for column, of in enumerate(self.push) if of in (-1, push)]

    def values(self, z: Tensor, push: int = 0) -> dict[str, Tensor]:
        """Physical values of all unknowns, free and held, for one push.

        Args:
            z: (..., p).
            push: Number of the push.

        Returns:
            (...) for each name; differentiable in z.
        """
        values = {name: z.new_full(z.shape[:-1], centre) for name, centre in self.centre.items()}
        for column in self.columns(push):
            unknown = self.free[column]
            change = unknown.scale * z[..., column]
            centre = self.centre[unknown.name]
            values[unknown.name] = centre * change.exp() if unknown.positive else centre + change
        return values

    def named(self, z: Tensor) -> dict[str, float]:
        """Physical values of the free unknowns of z (p,), by `names`."""
        values = [self.values(z, push) for push in range(self.pushes)]
        of = zip(self.names, self.free, self.push, strict=True)
        return {name: float(values[max(push, 0)][unknown.name]) for name, unknown, push in of}

    def clamp(self, z: Tensor) -> Tensor:
        """Return the z nearest to one (..., p) within the bounds."""
        return torch.minimum(torch.maximum(z, self.low), self.high)

    def draw(self, number: int, generator: torch.Generator) -> Tensor:
        """Random starts (number, p), uniform within each unknown's spread; the first is the centre.

        Every other one has the centre of mass of a uniform solid, which most objects nearly are.
        """
        spread = torch.tensor([unknown.spread / unknown.scale for unknown in self.free], dtype=torch.float64)
        z = (2.0 * torch.rand(number, len(self), generator=generator, dtype=torch.float64) - 1.0) * spread
        z[::2, [unknown.name.startswith("center_") for unknown in self.free]] = 0.0
        z[0] = 0.0
        return self.clamp(z)

    def draw_prior(self, number: int, generator: torch.Generator) -> Tensor:
        """Draws (number, p) from the prior, moved to its bounds where they are beyond."""
        noise = torch.randn(number, len(self), generator=generator, dtype=torch.float64)
        return self.clamp(noise @ torch.linalg.cholesky(torch.linalg.inv(self.precision)).T)

    def penalty(self, z: Tensor) -> Tensor:
        """Minus the logarithm of the prior of z (..., p), up to a constant."""
        return 0.5 * (z * (z @ self.precision)).sum(-1)
