# SPDX-License-Identifier: MIT
"""Figure of a training: success and length of episodes over the time it took."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from pinwm_drake.errors import InputError
from pinwm_drake.reading.tables import read_rows
from pinwm_drake.report.style import new_figure, save_figure, tidy

_COLUMNS = ("steps", "success", "length", "loss", "seconds")


def training_figure(path: Path, stages: Mapping[str, Path]) -> None:
    """Draws success, number of actions and loss of each stage, one after the other.

    Args:
        path: File of the figure.
        stages: `history.csv` of each, by name, in their order.

    Raises:
        InputError: A table cannot be read, or the picture cannot be written.
    """
    figure = new_figure(9, 3.0)
    panels = figure.subplots(1, 3)
    begin = 0.0
    for name, table in stages.items():
        columns = _read(table)
        minutes = begin + columns["seconds"] / 60
        for axes, values in zip(panels, (100 * columns["success"], columns["length"], columns["loss"]), strict=True):
            axes.plot(minutes, values, marker=".", label=name)
        begin = float(minutes[-1])
    for axes, title in zip(panels, ("success [%]", "actions of a success", "loss"), strict=True):
        axes.set_title(title, fontsize=9)
        axes.set_xlabel("minutes")
    panels[0].set_ylim(-2, 102)
    panels[2].set_yscale("log")
    panels[0].legend(frameon=False, fontsize=8)
    tidy(panels)
    save_figure(path, figure)


def _read(table: Path) -> dict[str, np.ndarray]:
    try:
        (_, header), *rows = read_rows(table) or [(1, [])]
        return {name: np.array([float(cells[header.index(name)]) for _, cells in rows]) for name in _COLUMNS}
    except (ValueError, IndexError) as error:
        raise InputError(table, value=error, allowed=f"a table with {', '.join(_COLUMNS)}") from error
