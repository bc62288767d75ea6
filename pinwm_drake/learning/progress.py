"""What is told of a training while it goes on."""

from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class Step:
    """Where a training stands.

    Attributes:
        stage: "teacher", "distil" or "ppo".
        done: Share of the stage's work, 0 to 1.
        steps: Of the worlds so far, in this stage.
        success: Share of the episodes of the last round's evaluation that succeeded; NaN before the first.
        length: Mean number of actions, of all of them.
        loss: Of the last update; of PPO its value loss.
        best: Success of the best round so far.
        seconds: Time taken, all runs of the stage together.
    """

    stage: str
    done: float
    steps: int
    success: float
    length: float
    loss: float
    best: float
    seconds: float


Report = Callable[[Step], None]


def silent(step: Step) -> None:
    """Tells nothing."""
