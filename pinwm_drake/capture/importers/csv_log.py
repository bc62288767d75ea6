# SPDX-License-Identifier: MIT
"""Logs in files of comma-separated values, with a header or without one."""

import csv
import io
import math
from pathlib import Path

import numpy as np

from pinwm_drake.capture.episode_tables import quote
from pinwm_drake.capture.importers.film import Columns, counted
from pinwm_drake.errors import InputError
from pinwm_drake.reading.contents import guarded, read_text

_SEPARATORS = ",;\t "
_MOST_ROWS, _MOST_CELLS = 2_000_000, 1000


def read_csv(path: Path) -> Columns:
    """Read the columns of numbers of a CSV file; commas, semicolons, tabs or spaces stand between its cells.

    Without a header columns are called 1, 2, 3 and so on. Lines that begin with # are comments. Cells that are empty
    or hold text are NaN; rows with another number of cells than the first are dropped and counted.

    Raises:
        InputError: The file cannot be read, or holds no row of numbers.
    """
    text = read_text(path)
    lines = [line for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")]
    if not lines:
        raise InputError(path, value="no row", allowed="a header and rows of numbers")
    separator = next((one for one in _SEPARATORS if one in lines[0]), " ")
    rows: list[tuple[int, list[str]]] = []
    with guarded(path, "comma-separated values"):
        reader = csv.reader(io.StringIO(text, newline=""), delimiter=separator, skipinitialspace=True)
        for cells in reader:
            if any(cell.strip() for cell in cells) and not cells[0].lstrip().startswith("#"):
                rows.append((reader.line_num, [cell.strip() for cell in cells]))
            if len(rows) > _MOST_ROWS or len(cells) > _MOST_CELLS:
                allowed = f"{_MOST_ROWS} rows and {_MOST_CELLS} columns at most"
                raise InputError(path, row=reader.line_num, value="more of them", allowed=allowed)
    header = rows[0][1]
    if not any(math.isnan(_value(cell)) for cell in header):
        names = [str(k + 1) for k in range(len(header))]
    else:
        names, rows = header, rows[1:]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise InputError(path, row=rows[0][0] if rows else 1, value=f"{quote(twice)} twice", allowed="each column once")
    whole = [(line, cells) for line, cells in rows if len(cells) == len(names)]
    if len(whole) < 1:
        raise InputError(path, value="no row below the header", allowed="rows of numbers")
    values = np.array([[_value(cell) for cell in cells] for _, cells in whole])
    lost = len(rows) - len(whole)
    notes = (f"{counted(lost, 'row')} with another number of cells than the header dropped",) if lost else ()
    return Columns(path, dict(zip(names, values.T, strict=True)), np.array([line for line, _ in whole]), notes=notes)


def _value(cell: str) -> float:
    try:
        return float(cell)
    except ValueError:
        return math.nan
