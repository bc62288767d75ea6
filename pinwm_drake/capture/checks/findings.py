# SPDX-License-Identifier: MIT
"""The problems of a capture, noted one after the other."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from pinwm_drake.errors import InputError, PinwmError


@dataclass(frozen=True, eq=False)
class Problem:
    """Problem of a capture, with its path in the capture: an error makes it unusable, a warning may cost accuracy."""

    severity: Literal["error", "warning"]
    problem: InputError


class Findings:
    """Collection of the problems of a capture, each noted once, in their order."""

    def __init__(self, folder: Path) -> None:
        self.problems: list[Problem] = []
        self._folder = folder
        self._seen: set[str] = set()

    def error(self, error: PinwmError) -> None:
        """Note an error, once."""
        self._note("error", error)

    def warn(self, path: Path, found: str, expected: str, row: int | None = None) -> None:
        """Note a warning, once: what was found in a file or folder, and a better state of it, in words."""
        self._note("warning", InputError(path, row=row, value=found, allowed=expected))

    def doubt(self, errors: list[InputError]) -> None:
        """Note errors as warnings, each once."""
        for error in errors:
            self._note("warning", error)

    def _note(self, severity: Literal["error", "warning"], error: PinwmError) -> None:
        if str(error) not in self._seen:
            self._seen.add(str(error))
            if not isinstance(error, InputError):
                error = InputError(self._folder, value=str(error), allowed="values in range")
            path = Path(error.path)
            if path != self._folder and path.is_relative_to(self._folder):  # the capture is known: a short message
                place = path.relative_to(self._folder)
                error = InputError(place, allowed=error.allowed, row=error.row, value=error.value)
            self.problems.append(Problem(severity, error))
