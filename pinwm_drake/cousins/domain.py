# SPDX-License-Identifier: MIT
"""Domains: physics and colours that a world takes on when an episode begins, and the source of them for a training.

Cousins of a twin are domains; methods that randomise otherwise differ from them in the domain alone.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from pinwm_drake.cousins.cousin import Cousin, CousinDraw
from pinwm_drake.twin.twin import Twin

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
    """

    delta: float = 0.1
    from_intervals: bool = False
    seed: int = 0

    def draw(self, twin: Twin) -> DomainDraw | None:
        """Return the function from a number to its cousin; None where nothing is drawn.

        Raises:
            ParameterError: delta or seed is out of range.
        """
        cousins = CousinDraw(twin, delta=self.delta, from_intervals=self.from_intervals, seed=self.seed)
        return cousins.cousin if self.delta > 0 or self.from_intervals else None

    def about(self) -> dict[str, object]:
        """Return settings by name, for a checkpoint."""
        return {"delta": self.delta, "from_intervals": self.from_intervals, "cousin_seed": self.seed}
