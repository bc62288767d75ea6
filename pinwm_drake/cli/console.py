"""The console: lines, and bars that tell of long work; where the output is no terminal, lines in their place."""

from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, Progress, ProgressColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn

_PERIOD = 1800.0  # s, over which the time left is reckoned; an episode in a plant takes most of a minute


def say(text: str, *, style: str | None = None) -> None:
    """Prints a line as it is: neither broken nor coloured by what it says."""
    Console().print(text, style=style, highlight=False, soft_wrap=True, markup=False)


@contextmanager
def progress_bar(
    figures: str = "{task.percentage:.0f} %", *, elapsed: bool = True, transient: bool = False
) -> Iterator[Progress]:
    """A bar for each task that is added, with the time left.

    Args:
        figures: Between bar and times, as rich formats it.
        elapsed: Whether the time so far is shown too.
        transient: Whether the bar goes when it is done.

    Yields:
        The bars.
    """
    columns: list[ProgressColumn] = [TextColumn("{task.description}"), BarColumn(bar_width=20), TextColumn(figures)]
    columns += [TimeElapsedColumn()] if elapsed else []
    columns += [TimeRemainingColumn(), TextColumn("left")]
    with Progress(*columns, transient=transient, speed_estimate_period=_PERIOD) as bar:
        yield bar
