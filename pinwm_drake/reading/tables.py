# SPDX-License-Identifier: MIT
"""Rows of CSV files, of a limited number and width, and the numbers in their cells."""

import csv
import io
import math
import re
from collections.abc import Iterator
from pathlib import Path

from pinwm_drake.errors import InputError
from pinwm_drake.reading.contents import guarded, read_text

_MOST_ROWS, _MOST_CELLS = 1_000_000, 1000
_ALLOWED = "comma-separated values"
_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?", re.ASCII)


def read_rows(path: Path, separators: str = ",", comment: str = "") -> list[tuple[int, list[str]]]:
    """Read the rows of a CSV file, each with the number of its line, counted from 1.

    Args:
        path: The file.
        separators: What may stand between cells; the first of these that is in the first line with contents counts.
            Where there are several, spaces after one are no part of a cell, which may be quoted.
        comment: Beginning of lines that are no rows; empty for none.

    Raises:
        InputError: The file cannot be read, is no CSV, or has too many rows or cells; the message names the line.
    """
    text = read_text(path)
    first = next((line for line in _lines(text, comment) if line.strip()), "")
    separator = next((one for one in separators if one in first.strip()), separators[0])
    spaced, lines = separator == " ", _lines(text, comment)
    reader = csv.reader(
        (line.strip() for line in lines) if spaced else lines,
        delimiter=separator,
        skipinitialspace=len(separators) > 1,
        strict=True,
    )
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


def _lines(text: str, comment: str) -> Iterator[str]:
    """Lines of a text; those that are comments are empty, so that others keep their numbers."""
    for line in io.StringIO(text, newline=""):
        yield "\n" if comment and line.lstrip().startswith(comment) else line


def cell_number(cell: str) -> float:
    """Finite number that a cell holds in plain digits; NaN for anything else."""
    text = cell.strip()
    value = float(text) if _NUMBER.fullmatch(text) else math.nan
    return value if math.isfinite(value) else math.nan
