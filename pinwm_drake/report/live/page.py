# SPDX-License-Identifier: MIT
"""Page of a run that goes on: `progress.html`, which reloads itself, and the same picture as `progress.png`."""

import base64
import io
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from pinwm_drake.files import replacing
from pinwm_drake.provenance import timestamp
from pinwm_drake.report.page import write_page
from pinwm_drake.report.style import GRID, plain_log

PAGE_FILE, PICTURE_FILE = "progress.html", "progress.png"
Pair = tuple[np.ndarray, np.ndarray]
"""Picture (height, width, 3) in [0, 1], sRGB, and its rendering in the same form."""

_EVERY = 3.0  # s, between two pictures at the least, and between two looks of the browser
_SHARE = 0.03  # of the time of a run that the pictures take at the most
_MOST = 2000  # points of a curve
_GAP = 6  # px, between pictures


class ProgressPage:
    """Page in a folder, which is replaced as a whole now and then while a run goes on.

    Drawing takes 3 % of the run's time at the most: the slower it is, the fewer pictures there are.

    Args:
        folder: The folder, which exists.
        title: Stands in the page.
        every: s, between two pictures at the least.
        share: Share of the time that drawing may take.

    Raises:
        InputError: A file cannot be written.
    """

    def __init__(self, folder: Path, title: str, *, every: float = _EVERY, share: float = _SHARE) -> None:
        self._folder, self._title, self._every, self._share = folder, title, every, share
        self._losses: dict[str, list[float]] = {}
        self._due = -np.inf

    def add(self, stage: str, loss: float) -> None:
        """Add a loss to the curve of a stage; one that is not finite is left out."""
        if np.isfinite(loss):
            self._losses.setdefault(stage, []).append(loss)

    def update(self, done: float, words: str, pairs: Callable[[], Sequence[Pair]]) -> None:
        """Write the page anew where it is due.

        Args:
            done: Share of the run that is done.
            words: State of the run.
            pairs: Function that renders pictures; called only where the page is due.
        """
        began = time.monotonic()
        if began < self._due:
            return
        self._write(done, words, f"renewed at {timestamp()}; this page reloads itself", pairs(), refresh=True)
        spent = time.monotonic() - began
        self._due = time.monotonic() + max(self._every, spent / self._share)

    def end(self, words: str, pairs: Callable[[], Sequence[Pair]]) -> None:
        """Write the page for the last time, with the state and the pictures of the end; it does not reload itself."""
        self._write(1.0, words, f"ended at {timestamp()}", pairs(), refresh=False)

    def _write(self, done: float, words: str, note: str, pairs: Sequence[Pair], *, refresh: bool) -> None:
        buffer = io.BytesIO()
        _figure(self._losses, pairs).savefig(buffer, format="png")
        with replacing(self._folder / PICTURE_FILE) as temporary:
            temporary.write_bytes(buffer.getvalue())
        write_page(
            self._folder / PAGE_FILE,
            "report/live/page.html",
            title=self._title,
            done=done,
            words=words,
            note=note,
            refresh=round(self._every) if refresh else 0,
            picture=f"data:image/png;base64,{base64.b64encode(buffer.getvalue()).decode()}",
        )


def _figure(losses: dict[str, list[float]], pairs: Sequence[Pair]) -> Figure:
    """Figure of the losses so far, and of pictures above their renderings."""
    figure = Figure(figsize=(11, 3.6), dpi=100)
    curve, pictures = figure.add_axes((0.07, 0.14, 0.30, 0.76)), figure.add_axes((0.40, 0.04, 0.59, 0.86))
    first = 0
    for stage, values in losses.items():
        step = -(-len(values) // _MOST)
        curve.plot(np.arange(first + 1, first + len(values) + 1)[::step], values[::step], linewidth=1, label=stage)
        first += len(values)
    if losses and min(min(values) for values in losses.values()) > 0:
        plain_log(curve)
    curve.set(xlabel="iteration", title="loss")
    if len(losses) > 1:
        curve.legend(frameon=False, fontsize=8)
    curve.grid(color=GRID)
    curve.spines[["top", "right"]].set_visible(False)
    pictures.set_axis_off()
    if pairs:
        pictures.imshow(_joined(pairs), interpolation="nearest")
        pictures.set_title("above: pictures of the capture; below: how they are rendered now")
    return figure


def _joined(pairs: Sequence[Pair]) -> np.ndarray:
    """One picture of all: each with its rendering below it."""
    height, width = (max(target.shape[axis] for target, _ in pairs) for axis in (0, 1))
    sheet = np.ones((2 * height + _GAP, len(pairs) * (width + _GAP) - _GAP, 3))
    for number, pair in enumerate(pairs):
        for row, picture in enumerate(pair):
            y, x = row * (height + _GAP), number * (width + _GAP)
            sheet[y : y + picture.shape[0], x : x + picture.shape[1]] = picture
    return np.clip(sheet, 0, 1)
