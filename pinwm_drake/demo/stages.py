# SPDX-License-Identifier: MIT
"""Stages of a demonstration: what is shown while they run, and the seconds that each took."""

import resource
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

Report = Callable[[float, str], None]
_STEP = 0.25  # share of a stage after which a line follows where there is no terminal


@dataclass(frozen=True)
class Cost:
    """Time that a stage took, on the wall and of all cores."""

    name: str
    seconds: float
    cpu_seconds: float


class Stages:
    """Runs stages one after the other, with a bar each on a terminal and plain lines elsewhere."""

    def __init__(self, console: Console) -> None:
        self.console = console
        self.costs: list[Cost] = []
        self._begun = time.perf_counter()

    @property
    def seconds(self) -> float:
        """Wall time [s] since the stages were made."""
        return time.perf_counter() - self._begun

    @contextmanager
    def stage(self, name: str) -> Iterator[Report]:
        """Show one stage and measure it.

        Yields:
            A function to call with the share that is done, 0 to 1, and figures in words.
        """
        seconds, cpu, live = time.perf_counter(), cpu_seconds(), self.console.is_terminal
        bar, figures = BarColumn(bar_width=20), TextColumn("{task.fields[words]}")
        columns = (TextColumn("{task.description:<24}"), bar, TimeElapsedColumn(), TimeRemainingColumn(), figures)
        if not live:
            self.say(f"{name} ...")
        with Progress(*columns, console=self.console, transient=True, disable=not live) as progress:
            task, due = progress.add_task(name, total=1.0, words=""), _STEP

            def report(share: float, words: str) -> None:
                nonlocal due
                progress.update(task, completed=share, words=words)
                if not live and due <= share < 1.0:
                    self.say(f"  {100 * share:.0f} %  {words}")
                    due = share + _STEP

            yield report
        self.costs.append(Cost(name, time.perf_counter() - seconds, cpu_seconds() - cpu))
        self.say(f"{name}: {self.costs[-1].seconds:.1f} s")

    def say(self, line: str) -> None:
        """Print a line as it is."""
        self.console.print(line, highlight=False, soft_wrap=True, markup=False)


def cpu_seconds() -> float:
    """Time [s] that this process's threads have taken of the cores."""
    usage = resource.getrusage(resource.RUSAGE_SELF)
    return usage.ru_utime + usage.ru_stime
