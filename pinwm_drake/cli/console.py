# SPDX-License-Identifier: MIT
"""The console: lines, and bars that show the progress of long work."""

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from rich.console import Console
from rich.progress import (
    BarColumn,
    Progress,
    ProgressColumn,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

LOOPBACK = ("127.", "localhost", "::1")  # beginnings of addresses that other machines do not reach
_PERIOD = 1800.0  # s, over which the time left is reckoned; an episode in a plant takes most of a minute


def say(text: str, *, style: str | None = None) -> None:
    """Print a line as it is: not broken, and not coloured by its contents."""
    Console().print(text, style=style, highlight=False, soft_wrap=True, markup=False)


class _LateProgress(Progress):
    """Bars that begin with the first task, so that work that is refused before prints nothing but its error."""

    def add_task(self, *arguments: Any, **options: Any) -> TaskID:
        """Add a bar, the first of which begins the display; see `rich.progress.Progress.add_task`."""
        self.start()
        return super().add_task(*arguments, **options)


def duration(seconds: float) -> str:
    """Duration [s] as text in hours, minutes and seconds; dashes where it is not finite."""
    if not math.isfinite(seconds):
        return "-:--:--"
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes // 60}:{minutes % 60:02}:{rest:02}"


@contextmanager
def progress_bar(
    figures: str = "{task.percentage:.0f} %",
    *,
    left: str | None = None,
    elapsed: bool = True,
    transient: bool = False,
) -> Iterator[Progress]:
    """Return a bar for each task that is added, with the time left.

    Args:
        figures: Text between bar and times, in rich's format.
        left: Text of the time that is left, in rich's format; None for rich's own estimate.
        elapsed: Flag: the time so far is shown too.
        transient: Flag: the bar disappears when it is done.

    Yields:
        The bars.
    """
    columns: list[ProgressColumn] = [TextColumn("{task.description}"), BarColumn(bar_width=20), TextColumn(figures)]
    columns += [TimeElapsedColumn()] if elapsed else []
    columns += [TimeRemainingColumn(), TextColumn("left")] if left is None else [TextColumn(left)]
    bar = _LateProgress(*columns, transient=transient, speed_estimate_period=_PERIOD)
    try:
        yield bar
    finally:
        if bar.live.is_started:
            bar.stop()


@contextmanager
def stages_bar(*, transient: bool = False) -> Iterator[Callable[[str, float, str], None]]:
    """Return a bar for each stage of an experiment, as its callback names them.

    Args:
        transient: Flag: the bars disappear when all is done; then there are none where the output is no terminal.

    Yields:
        The callback: stage, share of it that is done, figures in words.
    """
    if transient and not Console().is_terminal:
        yield lambda stage, done, figures: None
        return
    with progress_bar("{task.percentage:.0f} %  {task.fields[figures]}", transient=transient) as bar:
        tasks: dict[str, TaskID] = {}

        def show(stage: str, done: float, figures: str) -> None:
            if stage not in tasks:
                tasks[stage] = bar.add_task(stage, total=1.0, figures=figures)
            bar.update(tasks[stage], completed=done, figures=figures)

        yield show
