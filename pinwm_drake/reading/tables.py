# SPDX-License-Identifier: MIT
"""Rows of CSV files, of a limited number and width."""

import csv
import io
from pathlib import Path

from pinwm_drake.errors import InputError
from pinwm_drake.reading.contents import guarded, read_text

_MOST_ROWS, _MOST_CELLS = 1_000_000, 1000
_ALLOWED = "comma-separated values"


def read_rows(path: Path) -> list[tuple[int, list[str]]]:
    """Read the rows of a CSV file, each with the number of its line, counted from 1.

    Raises:
        InputError: The file cannot be read, is no CSV, or has too many rows or cells; the message names the line.
    """
    text = read_text(path)
    reader = csv.reader(io.StringIO(text, newline=""), strict=True)
    rows: list[tuple[int, list[str]]] = []
    with guarded(path, _ALLOWED):
        try:
            for cells in reader:
                if len(rows) == _MOST_ROWS or len(cells) > _MOST_CELLS:
                    allowed = f"{_MOST_ROWS} rows and {_MOST_CELLS} columns at most"
                    raise InputError(path, row=reader.line_num, value="more of them", allowed=allowed)
                rows.append((reader.line_num, cells))
        except csv.Error as error:
            raise InputError(path, row=reader.line_num, value=str(error), allowed=_ALLOWED) from error
    return rows
