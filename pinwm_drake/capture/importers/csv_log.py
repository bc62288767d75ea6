# SPDX-License-Identifier: MIT
"""Logs in files of comma-separated values, with a header or without one."""

from pathlib import Path

import numpy as np

from pinwm_drake.capture.episode_tables import quote
from pinwm_drake.capture.importers.film import Columns, counted
from pinwm_drake.errors import InputError
from pinwm_drake.reading.tables import cell_number, read_rows

_NO_NUMBER = ("", "nan", "null", "none", "na", "n/a", "inf", "-inf")


def read_csv(path: Path) -> Columns:
    """Read the columns of numbers of a CSV file; commas, semicolons, tabs or spaces stand between its cells.

    Without a header columns are called 1, 2, 3 and so on. Lines that begin with # are comments. Cells that are empty
    or hold text are NaN; rows with another number of cells than the first are dropped and counted.

    Raises:
        InputError: The file cannot be read, its first row is neither a header nor a row of numbers, a name of the
            header comes twice, or there is no row of numbers.
    """
    found = read_rows(path, ",;\t ", comment="#")
    rows = [(line, cells) for line, cells in found if any(cell.strip() for cell in cells)]
    if not rows:
        raise InputError(path, value="no row", allowed="a header and rows of numbers")
    line, first = rows[0][0], [cell.strip() for cell in rows[0][1]]
    names = [str(k + 1) for k in range(len(first))]
    if _is_header(path, line, first):
        names, rows = first, rows[1:]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise InputError(path, row=line, value=f"{quote(twice)} twice", allowed="each column once")
    whole = [(line, cells) for line, cells in rows if len(cells) == len(names)]
    if not whole:
        raise InputError(path, value="no row below the header", allowed="rows of numbers")
    values = np.array([[cell_number(cell) for cell in cells] for _, cells in whole])
    short = [line for line, cells in rows if len(cells) != len(names)]
    dropped = f"{counted(len(short), 'row')} without {len(names)} cells dropped, the first row {min(short, default=0)}"
    place = {name: k for k, name in enumerate(names)}
    return Columns(
        path,
        dict(zip(names, values.T, strict=True)),
        np.array([line for line, _ in whole]),
        notes=(dropped,) if short else (),
        cell=lambda column, k: quote(whole[k][1][place[column]].strip()),
    )


def _is_header(path: Path, line: int, cells: list[str]) -> bool:
    """Flag: the first row holds names; InputError where it holds both names and numbers."""
    texts = [cell for cell in cells if np.isnan(cell_number(cell)) and cell.lower() not in _NO_NUMBER]
    numbers = [cell for cell in cells if not np.isnan(cell_number(cell))]
    if texts and numbers:
        found = f"{quote(texts[0])} beside {quote(numbers[0])}"
        raise InputError(path, row=line, value=found, allowed="a header of names, or a row of numbers")
    return bool(texts)
