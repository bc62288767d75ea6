# SPDX-License-Identifier: MIT
"""Settings of trainings, whose numbers are checked alike."""

import math
from dataclasses import asdict, dataclass
from typing import ClassVar

from pinwm_drake.errors import require


@dataclass(frozen=True)
class Options:
    """Settings whose numbers are finite, and positive; pairs of numbers are left to the subclass.

    Attributes:
        may_be_zero: Names of the numbers that may also be 0.
        up_to_one: Names of the numbers that are 1 at the most.

    Raises:
        ParameterError: A number is out of range.
    """

    may_be_zero: ClassVar[tuple[str, ...]] = ()
    up_to_one: ClassVar[tuple[str, ...]] = ()

    def __post_init__(self) -> None:
        for name, value in asdict(self).items():
            if isinstance(value, tuple):
                continue
            zero, one = name in self.may_be_zero, name in self.up_to_one
            allowed = math.isfinite(value) and (value >= 0 if zero else value > 0)
            require(name, value, allowed, "0 or more" if zero else "more than 0")
            require(name, value, value <= 1 or not one, "0 to 1" if zero else "up to 1")


@dataclass(frozen=True)
class RewardOptions(Options):
    """Settings that the algorithms share that learn from rewards, as SB3 names them.

    Attributes:
        steps: Number of steps of all worlds together; rounded up to whole rounds.
        round_steps: Number of steps of all worlds in a round; rounded up to whole actions or rollouts. An evaluation
            follows.
        batch_size: Number of steps in an update.
        learning_rate: Learning rate of Adam at first.
        last_share: Share of the learning rate that is left at the end; it falls evenly from round to round.
        gamma: Discount of an action.
        episodes: Number of episodes in an evaluation.
        patience: Number of rounds with hardly shorter episodes in their evaluation than one before them, which mostly
            succeeded, after which the training ends.
    """

    steps: int = 800_000
    round_steps: int = 40_000
    batch_size: int = 512
    learning_rate: float = 1e-3
    last_share: float = 0.1
    gamma: float = 0.95
    episodes: int = 128
    patience: int = 5
