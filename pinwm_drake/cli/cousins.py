# SPDX-License-Identifier: MIT
"""`pinwm cousins`: the ranges that cousins are drawn from, in a table."""

from typing import TYPE_CHECKING

from rich.console import Console

from pinwm_drake.cli.console import say, stages_bar
from pinwm_drake.experiments.requests.twins import CousinsRequest

if TYPE_CHECKING:
    from rich.table import Table

    from pinwm_drake.cousins.cousin import Cousins

COUSINS_FILE, FIGURE_FILE = "cousins.npz", "cousins.png"


def cousins(request: CousinsRequest) -> None:
    """Draw copies of a twin with other parameters and colours.

    A contact sheet shows them.
    """
    from pinwm_drake.cousins.cousin import draw_cousins
    from pinwm_drake.cousins.io import write_cousins
    from pinwm_drake.files import prepare_folder
    from pinwm_drake.report.figures.cousins import cousin_figure
    from pinwm_drake.twin.read import load_twin

    drawn = draw_cousins(
        load_twin(request.twin),
        request.number,
        request.delta,
        seed=request.seed,
        from_intervals=request.from_intervals,
    )
    prepare_folder(request.out)
    Console().print(_table(drawn))
    write_cousins(request.out / COUSINS_FILE, drawn)
    with stages_bar(transient=True) as show:
        cousin_figure(request.out / FIGURE_FILE, drawn, lambda share: show("drawing", share, "contact sheet"))
    moved = sum(cousin.moved for cousin in drawn.members) / request.number
    say(f"{100 * moved:.1f} % of the colours were kept back to be displayable")
    for name in (COUSINS_FILE, FIGURE_FILE):
        say(f"wrote {request.out / name}")


def _table(drawn: "Cousins") -> "Table":
    """Table of the parameters: the twin's value, the range, and the origin of that."""
    from rich.table import Table

    from pinwm_drake.twin.twin import THETA

    table = Table("parameter", box=None, pad_edge=False)
    for heading in ("twin", "from", "to"):
        table.add_column(heading, justify="right")
    table.add_column("unit")
    table.add_column("range of")
    for key, unit in THETA.items():
        one = drawn.draw.ranges[key]
        numbers = [f"{value:.4g}" for value in (drawn.draw.twin.theta[key].value, one.low, one.high)]
        table.add_row(key, *numbers, "" if unit == "1" else unit, one.source)
    return table
