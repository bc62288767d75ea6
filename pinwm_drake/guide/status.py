# SPDX-License-Identifier: MIT
"""States of the stages of a lab, and what the guide found."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from pinwm_drake.guide.stages import ACTS, Stage

State = Literal["done", "ready", "missing", "out of date", "interrupted", "failed"]


@dataclass(frozen=True)
class Status:
    """State of a stage.

    Attributes:
        stage: The stage.
        state: Its state.
        notes: Lines that it said when it ran.
        error: Why it failed; "" where it did not.
        changed: Names of inputs that are newer than its result.
        seconds: s that it took.
    """

    stage: Stage
    state: State
    notes: tuple[str, ...] = ()
    error: str = ""
    changed: tuple[str, ...] = ()
    seconds: float = 0.0


@dataclass(frozen=True)
class Guided:
    """A lab after the guide.

    Attributes:
        path: The lab's folder.
        seen: Stages up to the first that is not done.
        act: The act of a person that comes next.
        error: Why the last stage failed, or the file that is refused; "" where all went well.
    """

    path: Path
    seen: list[Status]
    act: str
    error: str

    @property
    def number(self) -> int | None:
        """Number of the act that comes next, from 1; None where something is to be mended."""
        return ACTS.index(self.act) + 1 if self.act in ACTS else None
