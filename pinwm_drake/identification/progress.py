"""Messages of a search: its progress while it goes on, and its evaluations afterwards."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np


@dataclass(frozen=True)
class Progress:
    """Progress of a search, to be shown while it goes on.

    Attributes:
        done: Share of the work, 0 to 1.
        stage: "screen", "coarse", "fine" or "sample".
        loss: Mean square of the stage's pictures for the best guess; not a number while draws are taken.
        values: Physical values of the free unknowns of that guess.
    """

    done: float
    stage: str
    loss: float
    values: Mapping[str, float]


@dataclass
class Log:
    """Log of every evaluation, the contents of `history.npz`."""

    iteration: list[int] = field(default_factory=list)
    loss: list[float] = field(default_factory=list)
    stage: list[str] = field(default_factory=list)
    start: list[int] = field(default_factory=list)
    theta: list[list[float]] = field(default_factory=list)

    def add(self, stage: str, start: int, loss: float, theta: list[float]) -> None:
        """Appends one evaluation; iterations count within each start."""
        self.iteration.append(self.start.count(start))
        self.loss.append(loss)
        self.stage.append(stage)
        self.start.append(start)
        self.theta.append(theta)

    def arrays(self) -> dict[str, np.ndarray]:
        """Columns of the log as arrays, by name."""
        return {
            "iteration": np.array(self.iteration, np.int64),
            "loss": np.array(self.loss, float),
            "stage": np.array(self.stage, dtype="U16"),
            "start": np.array(self.start, np.int64),
            "theta": np.array(self.theta, float),
        }

    @staticmethod
    def of(arrays: Mapping[str, np.ndarray]) -> "Log":
        """Log from its arrays, the inverse of `arrays`."""
        return Log(*(arrays[name].tolist() for name in ("iteration", "loss", "stage", "start", "theta")))
