# SPDX-License-Identifier: MIT
"""Progress of a training, for a bar, a line or a plot."""

import math
from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class Step:
    """State of a training that goes on.

    Attributes:
        stage: "waypoints", "teacher", "distil" or "ppo".
        done: Share of the stage's work that is done, 0 to 1.
        steps: Number of steps of all worlds so far, in this stage.
        success: Share of the episodes of the last round's evaluation that succeeded; NaN before the first.
        length: Mean number of actions of those episodes; NaN before the first.
        loss: Loss of the last update, that of the value with PPO; NaN before the first.
        best: Success of the best round so far; NaN before the first.
        seconds: s, time taken, all runs of the stage together.
        recent: Share of the last episodes of the training itself that succeeded; NaN where it is not known.
        rate: 1/s, steps of the worlds at the pace of this run; NaN before the second unit of work.
        left: s, until the stage is done at the pace of this run, or its budget is; NaN before the second unit of work.
    """

    stage: str
    done: float
    steps: int
    success: float
    length: float
    loss: float
    best: float
    seconds: float
    recent: float = math.nan
    rate: float = math.nan
    left: float = math.nan


Report = Callable[[Step], None]


def silent(step: Step) -> None:
    """Ignores the progress of a training."""
