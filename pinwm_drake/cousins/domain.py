# SPDX-License-Identifier: MIT
"""Domains: physics and colours that a world takes on when an episode begins, and the source of them for a training.

Cousins of a twin are domains; methods that randomise otherwise differ from them in the domain alone.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from pinwm_drake.cousins.cousin import Cousin, CousinDraw
from pinwm_drake.errors import require
from pinwm_drake.twin.rollout import SUPPORT
from pinwm_drake.twin.twin import Twin

_FRICTIONS = 2  # part of a cousin's draws; its physics and looks are parts 0 and 1
DomainDraw = Callable[[int], Cousin]


class DomainSource(Protocol):
    """A distribution of domains around a twin, which tells one training from another."""

    def draw(self, twin: Twin) -> DomainDraw | None:
        """Return the function from a number, 0 or more, to its domain; None where every world is the twin itself."""

    def about(self) -> dict[str, object]:
        """Return settings as JSON takes them: checkpoints of other settings are refused."""


@dataclass(frozen=True)
class CousinDomains:
    """Physics-aware digital cousins (PIN-WM, eq. 11) as the domains of a training.

    Attributes:
        delta: Relative half-width of the ranges, 0 or more, less than 1; with 0, and without intervals, all worlds are
            the twin.
        from_intervals: Flag: what was identified is drawn from the twin's posterior; see `CousinDraw`.
        seed: Seed of the draws, 0 or more.
        friction_floor, friction_pusher: Least and largest friction, drawn evenly in the place of the twin's; None for
            that of the cousins.
        widen: Flag: a friction whose identified interval is wider than delta is drawn from the twin's posterior.
        spread: Least and largest spread of the pressure on a face or line, drawn evenly for all three of `support_*`:
            1 is even, and ends alone carry at 1.7 to 1.9; None for the twin's.
    """

    delta: float = 0.1
    from_intervals: bool = False
    seed: int = 0
    friction_floor: tuple[float, float] | None = None
    friction_pusher: tuple[float, float] | None = None
    widen: bool = False
    spread: tuple[float, float] | None = None

    def draw(self, twin: Twin) -> DomainDraw | None:
        """Return the function from a number to its cousin; None where nothing is drawn.

        Raises:
            ParameterError: delta, seed or a friction is out of range.
        """
        cousins = CousinDraw(twin, delta=self.delta, from_intervals=self.from_intervals, seed=self.seed)
        ranges = {name: ends for name, ends in self._frictions().items() if ends is not None}
        wide = self.wide(twin)
        for name, (low, high) in ranges.items():
            require(name, f"{low} to {high}", 0.0 <= low <= high < math.inf, "0 or more, finite, the least first")
        if self.spread is not None:
            low, high = self.spread
            require("spread", f"{low} to {high}", 0.0 < low <= high < math.inf, "above 0, finite, the least first")
        if not ranges and not wide and self.spread is None:
            return cousins.cousin if self.delta > 0 or self.from_intervals else None

        def drawn(number: int) -> Cousin:
            cousin = cousins.cousin(number)
            generator = np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=(number, _FRICTIONS)))
            given = {name: float(generator.uniform(*ends)) for name, ends in ranges.items()}
            theta, shape = cousin.theta | _of_posterior(twin, wide, generator) | given, dict(cousin.shape)
            if self.spread is not None:
                shape |= dict.fromkeys(SUPPORT, float(generator.uniform(*self.spread)))
            return replace(cousin, theta=theta, shape=shape)

        return drawn

    def wide(self, twin: Twin) -> dict[str, tuple[float, float]]:
        """Identified 95 % intervals of frictions, by name, that are drawn from the posterior as delta is less."""
        if not self.widen or self.from_intervals or not self.delta > 0.0:
            return {}
        given = {name: twin.theta[name] for name, ends in self._frictions().items() if ends is None}
        return {
            name: one.interval
            for name, one in given.items()
            if one.interval is not None
            and all(map(math.isfinite, one.interval))
            and max(one.value - one.interval[0], one.interval[1] - one.value) > self.delta * one.value
        }

    def about(self) -> dict[str, object]:
        """Return settings by name, for a checkpoint."""
        # Checkpoints from before lack the frictions and `widen`, which reads as None.
        frictions = {name: ends and list(ends) for name, ends in self._frictions().items()}
        known: dict[str, object] = {"delta": self.delta, "from_intervals": self.from_intervals}
        spread = {} if self.spread is None else {"spread": list(self.spread)}
        return {**known, "cousin_seed": self.seed, **frictions, "widen": self.widen or None, **spread}

    def _frictions(self) -> dict[str, tuple[float, float] | None]:
        return {"friction_floor": self.friction_floor, "friction_pusher": self.friction_pusher}


def known_ranges(twin: Twin) -> dict[str, tuple[float, float]]:
    """Identified 95 % intervals of a twin's theta by name, or twice the value where there is none."""
    intervals = {name: one.interval or (one.value, one.value) for name, one in twin.theta.items()}
    return {name: ends for name, ends in intervals.items() if all(map(math.isfinite, ends))}


def _of_posterior(
    twin: Twin, intervals: Mapping[str, tuple[float, float]], generator: np.random.Generator
) -> dict[str, float]:
    """One draw of the frictions with these intervals together; each evenly from its own where a twin has no draws."""
    found: dict[str, float] = {}
    if twin.draws is not None:
        row = int(generator.integers(len(twin.draws.values)))
        found = {name: float(twin.draws.column(name)[row]) for name in intervals if name in twin.draws.names}
    for name, (low, high) in intervals.items():
        if name not in found:
            found[name] = float(generator.uniform(max(low, 0.0), high))
    return found
