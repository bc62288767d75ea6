# SPDX-License-Identifier: MIT
"""Tables of an episode: times of its images, poses of the pusher and of the object."""

import math
import os
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np

from pinwm_drake.capture.paths import require_file
from pinwm_drake.capture.refusals import Refuse, attempt, raise_it
from pinwm_drake.capture.scene import FARTHEST, UNIT_NORM
from pinwm_drake.documents import LONGEST_TEXT
from pinwm_drake.errors import InputError
from pinwm_drake.reading.tables import cell_number, read_rows

FRAMES_FILE, TRAJECTORY_FILE, POSES_FILE = "frames.csv", "trajectory.csv", "object_poses.csv"
FRAME_COLUMNS = ("frame", "file_path", "t")
POSITION, QUATERNION = ("px", "py", "pz"), ("qw", "qx", "qy", "qz")
VELOCITY, FORCE = ("vx", "vy", "vz"), ("fx", "fy", "fz")
# How far a frame may be outside the pusher's log [s]: times printed with six decimals.
_ROUNDING = 1.5e-6
_FASTEST, _STRONGEST = 1e3, 1e6  # m/s, N
_UPWARDS = 5e-3  # m, by which a pusher moves up or down in a poke
_LATEST = 1e11  # s; seconds since 1970 are well below
_LONGEST_QUOTE = 60  # characters of a value that a message repeats


@dataclass(frozen=True, eq=False)
class Table:
    """Table of a CSV file, its cells as text; each problem of it names file, line, column and value."""

    path: Path
    lines: list[int]  # of each row; the header's is 1
    cells: dict[str, list[str]]  # of each column, by its name
    refuse: Refuse

    def refusal(self, row: int, column: str, allowed: str, found: str | None = None) -> InputError:
        """Error of one cell, its row counted from 0 without the header; `found` stands for its text, in words."""
        found = quote(self.cells[column][row]) if found is None else found
        return InputError(self.path, row=self.lines[row], value=f"{column} = {found}", allowed=allowed)

    def numbers(self, columns: tuple[str, ...], bound: float = math.inf) -> np.ndarray:
        """Values (rows, columns) of finite numbers up to a bound, in the unit of the file; NaN for refused ones."""
        allowed = "a finite number" + ("" if math.isinf(bound) else f" from {-bound:g} to {bound:g}")
        values = np.full((len(self.lines), len(columns)), np.nan)
        for row in range(len(self.lines)):
            for k, column in enumerate(columns):
                value = cell_number(self.cells[column][row])
                if abs(value) <= bound:
                    values[row, k] = value
                else:
                    self.refuse(self.refusal(row, column, allowed))
        return values

    def times(self) -> np.ndarray:
        """Time (rows,) [s] of column t, each later than the one before."""
        times = self.numbers(("t",), _LATEST)[:, 0]
        for row in (np.nonzero(np.diff(times) <= 0)[0] + 1).tolist():
            same = "the time of the row before again" if times[row] == times[row - 1] else "an earlier time"
            allowed = f"a time after {times[row - 1]:.9g} s, that of the row before ({same})"
            self.refuse(self.refusal(row, "t", allowed))
        return times

    def quaternions(self, unit_norm: float = UNIT_NORM) -> np.ndarray:
        """Return the unit quaternions (rows, 4), wxyz, normalised; their norms may be 1 to within `unit_norm`."""
        values = self.numbers(QUATERNION)
        with np.errstate(over="ignore"):
            norms = np.linalg.norm(values, axis=-1, keepdims=True)
        for row in np.nonzero(np.abs(norms[:, 0] - 1) > unit_norm)[0].tolist():
            cells = ", ".join(quote(self.cells[column][row]) for column in QUATERNION)
            found = f"({cells}), of norm {norms[row, 0]:.6g}"
            self.refuse(self.refusal(row, "qw, qx, qy, qz", "a quaternion (w, x, y, z) of norm 1", found))
        return values / np.where(norms > 0, norms, 1)


def read_table(
    path: Path,
    columns: tuple[str, ...],
    optional: tuple[str, ...] = (),
    refuse: Refuse = raise_it,
    forms: tuple[tuple[str, ...], ...] = (),
    *,
    gaps: bool = False,
) -> Table:
    """Read a CSV file with a header, one row or more, and its columns in any order.

    Args:
        path: The file.
        columns: The columns that it has to have.
        optional: Columns that it may have besides, all of them or none.
        forms: Columns that it may have in place of `columns`.
        refuse: Receives the problems of the table's rows and cells.
        gaps: Flag: there may be rows without contents, which are left out.

    Raises:
        InputError: The file cannot be read, has other columns, or no rows; the message names the line.
    """
    allowed = "columns " + " or ".join(map(",".join, (columns, *forms)))
    allowed += f" and, if measured, {','.join(optional)}" if optional else ""
    (_, names), *rows = read_rows(path) or [(1, [])]
    header = [name.strip() for name in names]
    while rows and not rows[-1][1]:
        rows.pop()  # empty lines at the end
    if gaps:
        rows = [(line, cells) for line, cells in rows if any(cell.strip() for cell in cells)]
    if sorted(header) not in map(sorted, (columns, (*columns, *optional), *forms)):
        raise InputError(path, row=1, value=quote(",".join(header)), allowed=allowed)
    if not rows:
        raise InputError(path, value="no row below the header", allowed="one row or more")
    for line, cells in rows:
        if len(cells) != len(header):
            refuse(InputError(path, row=line, value=f"{len(cells)} cells", allowed=f"{len(header)}, as in the header"))
    whole = [(line, cells) for line, cells in rows if len(cells) == len(header)]
    if not whole:
        raise InputError(path, value="no row that is whole", allowed="one row or more")
    lines = [line for line, _ in whole]
    return Table(path, lines, {name: [cells[k] for _, cells in whole] for k, name in enumerate(header)}, refuse)


def quote(text: str) -> str:
    """Quotation of a text in a message: printable, and cut where it is long."""
    text = text if len(text) <= _LONGEST_QUOTE else text[:_LONGEST_QUOTE] + "..."
    return text if text.isprintable() and text else ascii(text)


Motion = Literal["push", "poke"]  # level, or also upwards, to rock or turn the object


@dataclass(frozen=True, eq=False)
class PusherTrajectory:
    """Poses of the pusher at m times; in between it moves on straight lines.

    Attributes:
        t: (m,) [s], increasing.
        p_WP: (m, 3) [m].
        q_WP: (m, 4), wxyz, unit norm.
        v_WP: (m, 3) [m/s], the commanded velocity from each time to the next.
        force_W: (m, 3) [N], that the object exerts on the pusher, as a sensor in the pusher's stem reads it without the
            pusher's own weight; axes of the world. None where it was not measured.
    """

    t: np.ndarray
    p_WP: np.ndarray
    q_WP: np.ndarray
    v_WP: np.ndarray
    force_W: np.ndarray | None

    @property
    def motion(self) -> Motion:
        """Kind of motion: a poke moves up or down by more than 5 mm."""
        return "poke" if float(np.ptp(self.p_WP[:, 2])) > _UPWARDS else "push"


@dataclass(frozen=True, eq=False)
class ObjectPoses:
    """Poses of the object at n times.

    Attributes:
        t: (n,) [s], increasing.
        p_WO: (n, 3) [m].
        q_WO: (n, 4), wxyz, unit norm.
    """

    t: np.ndarray
    p_WO: np.ndarray
    q_WO: np.ndarray


def read_trajectory(folder: Path, refuse: Refuse = raise_it) -> PusherTrajectory:
    """Return the pusher's log from `trajectory.csv` of an episode, with the errors of `read_pose_table`."""
    columns = ("t", *POSITION, *QUATERNION, *VELOCITY)
    table = read_table(folder / TRAJECTORY_FILE, columns, FORCE, refuse)
    return PusherTrajectory(
        t=table.times(),
        p_WP=table.numbers(POSITION, FARTHEST),
        q_WP=table.quaternions(),
        v_WP=table.numbers(VELOCITY, _FASTEST),
        force_W=table.numbers(FORCE, _STRONGEST) if FORCE[0] in table.cells else None,
    )


def read_object_poses(folder: Path, refuse: Refuse = raise_it) -> ObjectPoses | None:
    """Return the object's poses from `object_poses.csv`, as `read_pose_table`; None where there is no such file."""
    path = folder / POSES_FILE
    return read_pose_table(path, refuse) if os.path.lexists(path) else None


def read_pose_table(path: Path, refuse: Refuse = raise_it) -> ObjectPoses:
    """Poses of an object from a table with the columns of `object_poses.csv`.

    Args:
        path: The file.
        refuse: Receives the problems of rows and cells; where it does not raise, NaN takes their place.

    Raises:
        InputError: The table cannot be used; see `episodes.read_episode`.
    """
    table = read_table(path, ("t", *POSITION, *QUATERNION), refuse=refuse)
    return ObjectPoses(table.times(), table.numbers(POSITION, FARTHEST), table.quaternions())


def read_frame_table(
    folder: Path, trajectory_t: np.ndarray | None, refuse: Refuse = raise_it
) -> tuple[list[str], np.ndarray]:
    """Return the images of an episode from `frames.csv`: their names as written, and their times (n,) [s].

    They are compared with the times (m,) [s] of the pusher's log, unless that is None. Errors are those of
    `read_pose_table`, and that an image is missing.
    """
    table = read_table(folder / FRAMES_FILE, FRAME_COLUMNS, refuse=refuse)
    t = table.times()
    _require_numbers(table)
    names = [text.strip() for text in table.cells["file_path"]]
    seen: dict[str, int] = {}
    for row, name in enumerate(names):
        first = seen.setdefault(name, table.lines[row])
        if first != table.lines[row]:
            refuse(table.refusal(row, "file_path", f"each image once (it is in row {first} too)"))
        if not name or not name.isprintable() or len(name) > LONGEST_TEXT:
            refuse(table.refusal(row, "file_path", "the name of an image file"))
        else:
            wanted = f"the image file of {table.path}, row {table.lines[row]}"
            attempt(partial(require_file, folder / name, wanted), refuse)
    if trajectory_t is not None:
        start, end = float(np.min(trajectory_t)), float(np.max(trajectory_t))
        for row in np.nonzero((t < start - _ROUNDING) | (t > end + _ROUNDING))[0].tolist():
            refuse(table.refusal(row, "t", f"a time within {TRAJECTORY_FILE}: {start:.9g} s to {end:.9g} s"))
    return names, t


def _require_numbers(table: Table) -> None:
    values = table.numbers(("frame",), 1e9)[:, 0]
    for row, value in enumerate(values.tolist()):
        before = values[row - 1] if row else -1.0
        if not np.isnan(value) and (value != np.floor(value) or value <= before):  # NaN was refused as no number
            allowed = "a whole number, larger than the one in the row before" if row else "a whole number from 0"
            table.refuse(table.refusal(row, "frame", allowed))
