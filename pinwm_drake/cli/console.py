# SPDX-License-Identifier: MIT
"""The console: lines, and the progress of long work as bars on a terminal and as lines where output is redirected."""

import codecs
import logging
import math
import os
import sys
import threading
import time
import unicodedata
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Protocol

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn

import pinwm_drake
from pinwm_drake.pace import Pace

LOOPBACK = ("127.", "localhost", "::1")  # beginnings of addresses that other machines do not reach
_FIRST, _LOOK = 5.0, 1.0  # s, of a stage without a line, and between two looks whether one is due
_FILTERS = "PYTHONWARNINGS"
_PERIOD, _GROWTH = 10.0, 0.05  # between two lines: s, and share of the time so far where that is longer


class Show(Protocol):
    """Callback that shows the progress of a stage."""

    def __call__(self, stage: str, done: float, figures: str, left: float | None = None, *, tell: bool = False) -> None:
        """Show a stage.

        Args:
            stage: Name of the stage.
            done: Share of it that is done, 0 to 1.
            figures: Figures in words.
            left: Time that is left, s; None for an estimate by the pace after the first unit of work.
            tell: Flag: where lines are printed, this one is, whatever the interval.
        """


# Signs of the package's words that have no decomposition.
_PLAIN = {
    "°": " deg",
    "μ": "mu",
    "…": "...",
    "θ": "theta",
    "×": "x",
    "–": "-",
    "—": "-",
    "→": "->",
    "±": "+-",
    "δ": "delta",
}


def spell(error: UnicodeError) -> tuple[str, int]:
    """Handler of codecs that spells what an encoding lacks: ² as 2, ° as deg, and a question mark for the rest."""
    if not isinstance(error, UnicodeEncodeError):
        raise error
    words = []
    for sign in error.object[error.start : error.end]:
        plain = _PLAIN.get(sign) or unicodedata.normalize("NFKD", sign).encode("ascii", "ignore").decode()
        words.append(plain or "?")
    return "".join(words), error.end


def take_any_terminal() -> None:
    """Let output and error output take any text, whatever the encoding of the terminal is."""
    codecs.register_error("pinwm", spell)
    for stream in (sys.stdout, sys.stderr):
        if reconfigure := getattr(stream, "reconfigure", None):
            reconfigure(errors="pinwm")


def say(text: str, *, style: str | None = None) -> None:
    """Print a line as it is: not broken, and not coloured by its contents."""
    Console().print(text, style=style, highlight=False, soft_wrap=True, markup=False)


def warn(text: str) -> None:
    """Print a line of warning to the error output."""
    Console(stderr=True, soft_wrap=True).print(f"[yellow]warning:[/] {escape(text)}", highlight=False)


@contextmanager
def quiet() -> Iterator[None]:
    """Context in which warnings of other libraries are not shown, and those of this package take one line."""
    package = Path(pinwm_drake.__file__).parent

    def show(
        message: Warning | str, category: type[Warning], filename: str, lineno: int, file: Any = None, line: Any = None
    ) -> None:
        if Path(filename).is_relative_to(package):
            warn(str(message))

    logging.getLogger("matplotlib").setLevel(logging.ERROR)  # it warns where it cannot keep its cache
    before = os.environ.get(_FILTERS)
    os.environ[_FILTERS] = "ignore"  # of processes that are started meanwhile
    try:
        with warnings.catch_warnings():
            warnings.showwarning = show
            yield
    finally:
        os.environ.pop(_FILTERS)
        if before is not None:
            os.environ[_FILTERS] = before


def duration(seconds: float) -> str:
    """Duration [s] as text in hours, minutes and seconds; dashes where it is not finite."""
    if not math.isfinite(seconds):
        return "-:--:--"
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes // 60}:{minutes % 60:02}:{rest:02}"


@contextmanager
def stages_bar(*, transient: bool = False) -> Iterator[Show]:
    """Show the stages of long work: a bar for each on a terminal, elsewhere a line now and then.

    Args:
        transient: Flag: the bars disappear when all is done, and the end of a stage has no line of its own.

    Yields:
        The callback.
    """
    if not Console().is_terminal:
        lines = _Lines(ends=not transient)
        try:
            yield lines.show
        finally:
            lines.close()
        return
    columns = (
        TextColumn("{task.description}"),
        BarColumn(bar_width=20),
        TextColumn("{task.percentage:.0f} %  {task.fields[figures]}", markup=False),
        TimeElapsedColumn(),
        TextColumn("{task.fields[left]} left"),
    )
    bars = _Bars(*columns, transient=transient)
    try:
        yield bars.show
    finally:
        if bars.live.is_started:
            bars.stop()


class _Bars(Progress):
    """Bars that begin with the first stage, so that work that is refused before prints nothing but its error."""

    def __init__(self, *columns: Any, **options: Any) -> None:
        super().__init__(*columns, **options)
        self._stages: dict[str, tuple[TaskID, Pace]] = {}

    def show(self, stage: str, done: float, figures: str, left: float | None = None, *, tell: bool = False) -> None:
        """Show a stage; see `Show`."""
        if stage not in self._stages:
            self.start()
            bar = self.add_task(stage, total=1.0, completed=0, figures=figures, left=duration(math.nan))
            self._stages[stage] = bar, Pace()
        bar, pace = self._stages[stage]
        _, estimate = pace(done)
        seconds = estimate if left is None else left
        self.update(bar, completed=done, figures=figures, left=duration(seconds))


class _Lines:
    """Printer of lines: at the end of a stage, and at intervals that grow with the time that it takes.

    A thread looks whether a line is due, so that work that does not report for a while is seen to go on.
    """

    def __init__(self, *, ends: bool) -> None:
        self._ends = ends
        self._stage, self._done, self._figures = "", 1.0, ""
        self._end = math.nan  # by the clock, s
        self._due = math.inf
        self._paces: dict[str, Pace] = {}
        self._lock, self._closed = threading.Lock(), threading.Event()
        threading.Thread(target=self._watch, daemon=True).start()

    def show(self, stage: str, done: float, figures: str, left: float | None = None, *, tell: bool = False) -> None:
        """Print a line where one is due; see `Show`."""
        with self._lock:
            now = time.monotonic()
            _, estimate = self._paces.setdefault(stage, Pace())(done)
            if stage != self._stage:
                self._stage, self._done, self._due = stage, 0.0, now + _FIRST
            ends = done >= 1.0 > self._done
            self._done, self._figures = done, figures
            self._end = now + (estimate if left is None else left)
            if tell or (self._ends if ends else done < 1.0 and now >= self._due):
                self._print(now)

    def close(self) -> None:
        """End the printing."""
        self._closed.set()

    def _watch(self) -> None:
        while not self._closed.wait(_LOOK):
            with self._lock:
                if self._done < 1.0 and (now := time.monotonic()) >= self._due:
                    self._print(now)

    def _print(self, now: float) -> None:
        taken = now - self._paces[self._stage].begun
        left = self._end - now if now <= self._end else math.nan  # what takes longer than was thought has no estimate
        self._due = now + max(_PERIOD, _GROWTH * taken)
        rest = f"{duration(taken)} taken" if self._done >= 1.0 else f"{duration(left)} left"
        say("  ".join(part for part in (f"{self._stage} {self._done:4.0%}", self._figures, rest) if part))
