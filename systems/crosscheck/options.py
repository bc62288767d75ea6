"""Options of a cross-check."""

import math
from dataclasses import dataclass

from pinwm_drake.errors import ParameterError, require
from pinwm_drake.systems.scenario.schema import ENGINES

PLANTS = tuple(name for name in ENGINES if name != "twin")
_MOST_PUSHES, _MOST_PROCESSES = 10_000, 64


@dataclass(frozen=True)
class CrossCheckOptions:
    """Options of a cross-check: engines, pushes, and thresholds of agreement.

    Attributes:
        engines: Drake's contact models, each compared with the twin.
        pushes: Number of pushes.
        seed: Seed of the pushes.
        threshold_translation: m, largest median over the pushes of the difference after rest.
        threshold_rotation: rad, likewise.
        processes: Number of processes that share the pushes.

    Raises:
        ParameterError: An option is out of range.
    """

    engines: tuple[str, ...] = PLANTS
    pushes: int = 20
    seed: int = 0
    threshold_translation: float = 3e-3
    threshold_rotation: float = math.radians(2.0)
    processes: int = 1

    def __post_init__(self) -> None:
        """Checks names and numbers."""
        for name in self.engines:
            if name not in PLANTS:
                raise ParameterError(f"engine: got {name!r}; allowed: {', '.join(PLANTS)}")
        if not self.engines or len(set(self.engines)) != len(self.engines):
            raise ParameterError(f"engines: got {', '.join(self.engines) or 'none'}; allowed: one or more, each once")
        require("pushes", self.pushes, 1 <= self.pushes <= _MOST_PUSHES, f"1 to {_MOST_PUSHES}")
        require("seed", self.seed, 0 <= self.seed < 2**63, "0 or more")
        require("processes", self.processes, 1 <= self.processes <= _MOST_PROCESSES, f"1 to {_MOST_PROCESSES}")
        translation, rotation = self.threshold_translation, self.threshold_rotation
        require("threshold of translation", translation, 0 < translation <= 1, "more than 0, up to 1 m")
        require("threshold of rotation", rotation, 0 < rotation <= math.pi, "more than 0, up to pi rad")
