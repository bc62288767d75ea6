# SPDX-License-Identifier: MIT
"""Progress of an experiment, told to a callback."""

from collections.abc import Callable

Progress = Callable[[str, float, str], None]
"""Called with the stage, the share of it that is done (0 to 1), and figures in words."""


def silent(stage: str, done: float, figures: str) -> None:
    """Ignores the progress of an experiment."""
