# SPDX-License-Identifier: MIT
"""History of an identification: every evaluation of a search, to and from `history.npz`."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pinwm_drake.checkpoints import load_arrays
from pinwm_drake.errors import InputError
from pinwm_drake.files import replacing

HISTORY_FILE = "history.npz"
_COLUMNS: dict[str, Any] = {"iteration": np.int64, "loss": float, "stage": "U16", "start": np.int64, "theta": float}


class Log:
    """Log of every evaluation, the contents of `history.npz`."""

    def __init__(self, arrays: Mapping[str, np.ndarray] | None = None) -> None:
        """Log from its arrays, the inverse of `arrays`; None for an empty one."""
        self._columns: dict[str, list[Any]] = {name: arrays[name].tolist() if arrays else [] for name in _COLUMNS}

    def add(self, stage: str, start: int, loss: float, theta: list[float]) -> None:
        """Append one evaluation; iterations count within each start."""
        row = (self._columns["start"].count(start), loss, stage, start, theta)
        for column, value in zip(self._columns.values(), row, strict=True):
            column.append(value)

    def arrays(self) -> dict[str, np.ndarray]:
        """Columns of the log as arrays, by name."""
        return {name: np.array(self._columns[name], dtype=kind) for name, kind in _COLUMNS.items()}


@dataclass(frozen=True, eq=False)
class History:
    """History of the optimiser: n evaluations of all random starts together."""

    iteration: np.ndarray  # (n,), number of the evaluation, counted within each start
    loss: np.ndarray  # (n,), mean square of the stage's pictures
    stage: np.ndarray  # (n,) text, name of the stage
    start: np.ndarray  # (n,), number of the random start
    theta: np.ndarray  # (n, p), the fitted parameters in physical units
    names: list[str]  # Names of the p parameters

    def starts(self) -> list[tuple[int, np.ndarray]]:
        """Return the number of each random start, and the rows (m,) of its evaluations in their order."""
        found = ((int(number), np.flatnonzero(self.start == number)) for number in np.unique(self.start))
        return [(number, rows[np.argsort(self.iteration[rows], kind="stable")]) for number, rows in found]

    def stage_begins(self) -> list[tuple[float, str]]:
        """Beginnings of the stages in the longest start: iteration and name of each."""
        if not len(self.iteration):
            return []
        rows = max((rows for _, rows in self.starts()), key=len)
        begins = [k for k in range(len(rows)) if k == 0 or self.stage[rows[k]] != self.stage[rows[k - 1]]]
        return [(float(self.iteration[rows[k]]), str(self.stage[rows[k]])) for k in begins]


def write_history(path: Path, names: Sequence[str], log: Log) -> None:
    """Write every evaluation of a search for unknowns of these names.

    Raises:
        InputError: The file cannot be written.
    """
    with replacing(path) as temporary:
        np.savez(temporary, allow_pickle=False, names=np.array(names), **log.arrays())


def read_history(path: Path) -> History:
    """Read the history that `pinwm identify` leaves beside a twin.

    Args:
        path: The file.

    Returns:
        The history; it may be empty.

    Raises:
        InputError: It is missing, unreadable, lacks an array, or the arrays do not fit together.
    """
    if not path.is_file():
        raise InputError(path, value="no such file", allowed="the history that `pinwm identify` writes")
    arrays, _ = load_arrays(path, "an npz file without pickles", told=False)
    for name in (*_COLUMNS, "names"):
        if name not in arrays:
            raise InputError(path, value=f"no array {name}", allowed="iteration, loss, stage, theta, names and start")
    n, p = arrays["iteration"].size, arrays["names"].size
    shapes = {"iteration": (n,), "loss": (n,), "stage": (n,), "start": (n,), "theta": (n, p), "names": (p,)}
    for name, shape in shapes.items():
        if arrays[name].shape != shape:
            raise InputError(path, value=f"{name} of shape {arrays[name].shape}", allowed=f"{shape}")
        if name not in ("stage", "names") and arrays[name].dtype.kind not in "iuf":
            raise InputError(path, value=f"{name} of type {arrays[name].dtype}", allowed="numbers")
    columns = {name: np.asarray(arrays[name], kind) for name, kind in _COLUMNS.items()}
    return History(**columns, names=[str(name) for name in arrays["names"]])
