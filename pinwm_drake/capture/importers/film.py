# SPDX-License-Identifier: MIT
"""Films and logs of a push, from whatever file they are in, and their time stamps in order."""

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pinwm_drake.errors import InputError

Frames = Callable[[Sequence[int]], Iterator[np.ndarray]]
_DROPPED = 1.6  # times the usual interval: a frame is missing
_EPOCH = 1e8  # s; times above are taken for seconds since 1970
# Units of time by the usual interval between stamps [s]: those of cameras and robots.
_INTERVALS = 5e-4, 1.5
_TIME_UNITS = (("s", 1.0), ("ms", 1e-3), ("us", 1e-6), ("ns", 1e-9))
_STAMP_NAME = re.compile(r"\d{9,19}(\.\d+)?", re.ASCII)


@dataclass(frozen=True, eq=False)
class Film:
    """Film of a push.

    Attributes:
        path: File or folder.
        t: (n,) [s], increasing: when frames were taken.
        shared: Flag: the times are of a clock that a log can have too; else they count from the film's start.
        frames: Gives the pictures (H, W, 3 or 4) uint8, RGB or RGBA, of increasing numbers.
        notes: What was found, guessed and dropped, each in one line.
    """

    path: Path
    t: np.ndarray
    shared: bool
    frames: Frames
    notes: tuple[str, ...] = ()

    @property
    def rate(self) -> float:
        """Usual number of frames in a second."""
        return 1.0 / float(np.median(np.diff(self.t)))


@dataclass(frozen=True, eq=False)
class Columns:
    """Named columns of numbers from a log, as they were written.

    Attributes:
        path: File or folder.
        values: (m,) of each name; NaN where a cell holds no finite number.
        rows: (m,) places in the file for messages, counted from 1.
        time: Name of the column that holds seconds on the clock of the file; empty where the map has to name it.
        notes: What was found, guessed and dropped.
        si: Flag: the format says that numbers are in SI units and radians.
        cell: Text of a cell by the name of its column and its number in `values`, for messages.
    """

    path: Path
    values: dict[str, np.ndarray]
    rows: np.ndarray
    time: str = ""
    notes: tuple[str, ...] = ()
    si: bool = False
    cell: Callable[[str, int], str] = lambda column, k: ""

    def told(self, column: str, k: int) -> str:
        """Column and contents of a cell, for messages."""
        return f"{column} = {self.cell(column, k) or f'{self.values[column][k]:.6g}'}"


def time_unit(path: Path, values: np.ndarray) -> tuple[str, float]:
    """Name and seconds of the unit that numbers (n,) of a clock are in, by their size and usual interval.

    Raises:
        InputError: No unit makes them those of a camera or a robot.
    """
    steps = np.diff(np.sort(values[np.isfinite(values)]))
    steps = steps[steps > 0]
    step, size = float(np.median(steps)) if len(steps) else 0.0, float(np.nanmedian(np.abs(values)))
    for name, seconds in _TIME_UNITS:  # stamps since 1970 tell their unit by their size
        if _EPOCH <= size * seconds <= 100 * _EPOCH and _INTERVALS[0] / 5 <= step * seconds <= 5 * _INTERVALS[1]:
            return name, seconds
    for name, seconds in _TIME_UNITS:
        if _INTERVALS[0] <= step * seconds <= _INTERVALS[1]:
            return name, seconds
    raise InputError(path, value=f"times {step:.4g} apart", allowed="a unit: t=NAME[s], [ms], [us] or [ns]")


def is_epoch(t: np.ndarray) -> bool:
    """Flag: times (n,) [s] count from 1970."""
    return float(np.median(t)) > _EPOCH


def in_order(path: Path, t: np.ndarray, what: str) -> tuple[np.ndarray, list[str]]:
    """Numbers of the stamps (n,) [s] that are kept, each later than all before; and notes on what is dropped.

    Args:
        path: The file, for messages.
        t: The stamps.
        what: Name of what they belong to, such as "frame".

    Raises:
        InputError: Fewer than two are left, or most of them go backwards.
    """
    finite = np.isfinite(t)
    latest, kept, same, back = -np.inf, [], 0, 0
    for k in np.nonzero(finite)[0].tolist():
        if t[k] > latest:
            kept.append(k)
            latest = t[k]
        elif t[k] == latest:
            same += 1
        else:
            back += 1
    notes = []
    for number, words in ((int((~finite).sum()), "without a time"), (same, "with the time of the one before")):
        if number:
            notes.append(f"{counted(number, what)} {words} dropped")
    if back:
        notes.append(f"{counted(back, what)} with a time that goes backwards dropped")
    if len(kept) < 2 or back > len(kept):
        found = f"{counted(len(kept), what)} with increasing times of {len(t)}"
        raise InputError(path, value=found, allowed="time stamps that increase")
    steps = np.diff(t[kept])
    usual = float(np.median(steps))
    wide = steps > _DROPPED * usual
    if wide.any() and what == "frame":
        missing = int(np.rint(steps[wide] / usual - 1).sum())
        first = float(t[kept][np.nonzero(wide)[0][0]] - t[kept[0]])
        notes.append(
            f"{counted(missing, what)} missing in {int(wide.sum())} gaps, the first {first:.3f} s from the start"
        )
    elif (steps > max(5 * usual, 0.1)).any():
        longest = int(np.argmax(steps))
        found = f"{int((steps > max(5 * usual, 0.1)).sum())} gaps"
        notes.append(
            f"{found} between {what}s, the longest of {steps[longest]:.3g} s; the pusher moves straight over them"
        )
    return np.array(kept), notes


def counted(number: int, what: str) -> str:
    """Number and noun: "1 frame", "3 frames"."""
    return f"{number} {what}{'' if number == 1 else 's'}"


def stamps_of_names(names: Sequence[str]) -> np.ndarray | None:
    """Numbers that files' names (without suffix) are, where all are time stamps; None otherwise."""
    if len(names) < 2 or not all(_STAMP_NAME.fullmatch(name) for name in names):
        return None
    return np.array([float(name) for name in names])
