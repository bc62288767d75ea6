"""Tables in CSV files; every problem names file, line, column and value."""

import csv
import io
import math
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pinwm_drake.capture.refusals import Refuse, raise_it
from pinwm_drake.documents import read_text
from pinwm_drake.errors import InputError

UNIT_NORM = 1e-5  # how far a quaternion may be from unit norm: that of one printed with six digits
_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?", re.ASCII)
_LATEST = 1e11  # s; seconds since 1970 are well below
_LONGEST_QUOTE = 60  # characters of a value that a message repeats


@dataclass(frozen=True, eq=False)
class Table:
    """Table of a CSV file, its cells as text.

    Attributes:
        path: The file.
        lines: The line of each row, counted from 1, the header's being 1.
        cells: The texts of each column, by its name.
        refuse: Receives each problem.
    """

    path: Path
    lines: list[int]
    cells: dict[str, list[str]]
    refuse: Refuse = raise_it

    def refusal(self, row: int, column: str, allowed: str, found: str | None = None) -> InputError:
        """Error of one cell, with file, row and column.

        Args:
            row: Counted from 0, without the header.
            column: Name of the column.
            allowed: Values that would have been accepted, in words.
            found: The finding, in words; None for the text of the cell.
        """
        found = quote(self.cells[column][row]) if found is None else found
        return InputError(self.path, row=self.lines[row], value=f"{column} = {found}", allowed=allowed)

    def numbers(self, columns: tuple[str, ...], bound: float = math.inf) -> np.ndarray:
        """Values of columns of finite numbers.

        Args:
            columns: Names of the columns.
            bound: The largest magnitude, in the unit of the columns.

        Returns:
            (rows, len(columns)) float64 in the unit of the file; NaN where a problem was only noted.

        Raises:
            InputError: A cell is no finite number of at most that magnitude.
        """
        allowed = "a finite number" + ("" if math.isinf(bound) else f" from {-bound:g} to {bound:g}")
        values = np.full((len(self.lines), len(columns)), np.nan)
        for row in range(len(self.lines)):
            for k, column in enumerate(columns):
                text = self.cells[column][row].strip()
                value = float(text) if _NUMBER.fullmatch(text) else math.nan
                if abs(value) <= bound and math.isfinite(value):
                    values[row, k] = value
                else:
                    self.refuse(self.refusal(row, column, allowed))
        return values

    def times(self) -> np.ndarray:
        """Times (rows,) [s] of column t, each later than the one before.

        Raises:
            InputError: A cell is no finite number, or not later than the one above it.
        """
        times = self.numbers(("t",), _LATEST)[:, 0]
        for row in (np.nonzero(np.diff(times) <= 0)[0] + 1).tolist():
            same = "the time of the row before again" if times[row] == times[row - 1] else "an earlier time"
            allowed = f"a time after {times[row - 1]:.9g} s, that of the row before ({same})"
            self.refuse(self.refusal(row, "t", allowed))
        return times

    def quaternions(self, columns: tuple[str, str, str, str] = ("qw", "qx", "qy", "qz")) -> np.ndarray:
        """Unit quaternions, w first: (rows, 4), normalised to rounding.

        Raises:
            InputError: A cell is no finite number, or a norm is not 1.
        """
        values = self.numbers(columns)
        with np.errstate(over="ignore"):
            norms = np.linalg.norm(values, axis=-1, keepdims=True)
        for row in np.nonzero(np.abs(norms[:, 0] - 1) > UNIT_NORM)[0].tolist():
            found = f"({', '.join(quote(self.cells[column][row]) for column in columns)}), of norm {norms[row, 0]:.6g}"
            self.refuse(self.refusal(row, "qw, qx, qy, qz", "a quaternion (w, x, y, z) of norm 1", found))
        return values / np.where(norms > 0, norms, 1)


def read_table(
    path: Path, columns: tuple[str, ...], optional: tuple[str, ...] = (), refuse: Refuse = raise_it
) -> Table:
    """Reads a CSV file with a header.

    Args:
        path: The file.
        columns: The columns that it has to have.
        optional: Columns that it may have besides, all of them or none.
        refuse: Receives the problems of the table's rows and cells.

    Returns:
        The table, with one row or more, columns in any order.

    Raises:
        InputError: The file cannot be read, has other columns, or no rows; the message names the line. A row
            with another number of cells goes to `refuse`.
    """
    allowed = f"columns {','.join(columns)}" + (f" and, if measured, {','.join(optional)}" if optional else "")
    reader = csv.reader(io.StringIO(read_text(path), newline=""), strict=True)
    try:
        header = [name.strip() for name in next(reader, [])]
        rows = [(reader.line_num, cells) for cells in reader]
    except csv.Error as error:
        raise InputError(path, row=reader.line_num, value=str(error), allowed="comma-separated values") from error
    while rows and not rows[-1][1]:
        rows.pop()  # empty lines at the end
    if sorted(header) not in (sorted(columns), sorted((*columns, *optional))):
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
