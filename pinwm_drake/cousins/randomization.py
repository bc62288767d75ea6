# SPDX-License-Identifier: MIT
"""Domains that are drawn from wide ranges, whatever a push has shown: domain randomisation, and its single draws.

Source: Tobin et al., "Domain randomization for transferring deep neural networks from simulation to the real world"
(IROS 2017).
"""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace

import numpy as np
import torch

from pinwm_drake.cousins.cousin import Cousin
from pinwm_drake.cousins.domain import DomainDraw
from pinwm_drake.cousins.theta import MOMENTS
from pinwm_drake.errors import ParameterError, require
from pinwm_drake.geometry.meshes import load_mesh, mass_properties
from pinwm_drake.rendering.harmonics import Y0
from pinwm_drake.twin.rollout import NO_EFFECT
from pinwm_drake.twin.twin import THETA, Twin

Span = tuple[float, float]
_FRICTIONS = ("friction_floor", "friction_pusher")
_RESTITUTIONS = ("restitution_floor", "restitution_pusher")


@dataclass(frozen=True)
class Spans:
    """Ranges R of the physical parameters, of a body of which nothing is known but its shape.

    Attributes:
        friction: Coefficients of friction, of the floor and of the pusher.
        mass: kg.
        restitution: Coefficients of restitution, of the floor and of the pusher.
        inertia: Factors of the inertia that a solid of uniform density and the drawn mass has.

    Raises:
        ParameterError: A range is empty, or beyond what a body can have.
    """

    friction: Span = (0.005, 0.5)
    mass: Span = (0.2, 5.0)
    restitution: Span = (0.0, 0.5)
    inertia: Span = (0.3, 3.0)

    def __post_init__(self) -> None:
        for name, (low, high) in asdict(self).items():
            positive = low > 0.0 or (name in ("friction", "restitution") and low == 0.0)
            require(name, [low, high], positive and low <= high < math.inf, "low to high, above 0")
        require("restitution", list(self.restitution), self.restitution[1] <= 1.0, "0 to 1")

    def around(self, middle: Mapping[str, float], share: float, inertia: float = 1.0) -> dict[str, Span]:
        """Ranges of a share of R's lengths, by the draw's names, around values; cut at the ends of R.

        Args:
            middle: Values of `THETA`'s parameters, of which moments do not count.
            share: Share of the lengths, more than 0, up to 1; 1 is R itself, wherever the middle is.
            inertia: Factor of the inertia in the middle.
        """
        values = {**{name: middle[name] for name in (*_FRICTIONS, *_RESTITUTIONS, "mass")}, "inertia": inertia}
        found = {}
        for name, value in values.items():
            low, high = getattr(self, name.split("_")[0])
            half = 0.5 * share * (high - low)
            found[name] = (low, high) if share == 1.0 else (max(low, value - half), min(high, value + half))
        return found


FLIP_SPANS = Spans(friction=(0.05, 1.0))


@dataclass(frozen=True)
class RandomDomains:
    """Domains drawn evenly from ranges; what was identified of the twin has no part in them.

    Attributes:
        spans: The ranges R.
        share: Share of the lengths of R that is drawn from, around the true theta; 1 for R itself.
        middle: Values of `THETA`'s parameters in the middle of that; not needed where the share is 1.
        once: Flag: all episodes are in the first domain, as one guess at the parameters.
        painted: Flag: the surfels' colours are drawn too, once, each alone; otherwise they are as the twin has them.
        seed: Seed of the draws, 0 or more.

    Raises:
        ParameterError: The share is out of range, or its middle is missing.
    """

    spans: Spans = field(default_factory=Spans)
    share: float = 1.0
    middle: Mapping[str, float] | None = None
    once: bool = False
    painted: bool = False
    seed: int = 0

    def __post_init__(self) -> None:
        require("share", self.share, 0.0 < self.share <= 1.0, "more than 0, up to 1")
        require("seed", self.seed, self.seed >= 0, "0 or more")
        if self.share < 1.0 and (self.middle is None or not set(THETA) <= set(self.middle)):
            raise ParameterError(f"middle: got {self.middle}; allowed with a share below 1: values of {list(THETA)}")

    def draw(self, twin: Twin) -> DomainDraw:
        """Return the function from a number to its domain, an object of the twin's shape that is otherwise drawn.

        Raises:
            InputError: The mesh cannot be read.
        """
        solid = mass_properties(load_mesh(twin.mesh_path), mass=1.0).inertia.diagonal()
        if self.middle is None:
            ranges = self.spans.around(dict.fromkeys(THETA, 0.0), 1.0)
        else:
            known = np.array([self.middle[name] for name in MOMENTS]) / (solid * self.middle["mass"])
            ranges = self.spans.around(self.middle, self.share, float(known.mean()))
        looks = _painted(twin, self.seed) if self.painted else twin.surfels.sh
        unknown = replace(twin, nuisance={}, draws=None)

        def domain(number: int) -> Cousin:
            number = 0 if self.once else number
            generator = np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=(number,)))
            drawn = {name: float(generator.uniform(*ends)) for name, ends in ranges.items()}
            moments = drawn.pop("inertia") * drawn["mass"] * solid
            theta = {**drawn, **dict(zip(MOMENTS, moments.tolist(), strict=True))}
            return Cousin(unknown, number, {name: theta[name] for name in THETA}, dict(NO_EFFECT), lambda: (looks, 0.0))

        return domain

    def about(self) -> dict[str, object]:
        """Return settings by name, for a checkpoint."""
        told = {"spans": {name: list(ends) for name, ends in asdict(self.spans).items()}, "share": self.share}
        middle = None if self.middle is None else {name: float(self.middle[name]) for name in THETA}
        return {**told, "middle": middle, "once": self.once, "painted": self.painted, "random_seed": self.seed}


def _painted(twin: Twin, seed: int) -> torch.Tensor:
    """Harmonics (N, K, 3) float32 of surfels that each have a colour of their own, the same from everywhere."""
    generator = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(0, 1)))
    sh = torch.zeros_like(twin.surfels.sh)
    sh[:, 0] = torch.from_numpy((generator.random((len(sh), 3)) - 0.5) / Y0).float()
    return sh
