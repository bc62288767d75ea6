"""`pinwm cousins`: options, and the ranges that were drawn from in a table."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console

from pinwm_drake.cli.console import say
from pinwm_drake.errors import require
from pinwm_drake.files import prepare_folder

if TYPE_CHECKING:
    from rich.table import Table

    from pinwm_drake.cousins.cousin import Cousins

COUSINS_FILE, FIGURE_FILE = "cousins.npz", "cousins.png"
_MOST = 200  # pictures that a sheet can show


def cousins(
    twin: Annotated[Path, typer.Argument(metavar="TWIN", help="Folder that `pinwm identify` wrote.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for cousins.npz and cousins.png.")],
    number: Annotated[int, typer.Option(help="How many, 1 to 200.")] = 16,
    delta: Annotated[float, typer.Option(help="Relative half-width of what is drawn, 0 or more, less than 1.")] = 0.1,
    from_intervals: Annotated[
        bool,
        typer.Option(
            "--from-intervals",
            help="Draw what was identified from the twin's posterior, all of it together; delta for the rest.",
        ),
    ] = False,
    seed: Annotated[int, typer.Option(help="Of the draws, 0 or more.")] = 0,
) -> None:
    """Draws copies of a twin with other physical parameters and colours, and shows them on a contact sheet."""
    from pinwm_drake.cousins.cousin import draw_cousins
    from pinwm_drake.cousins.io import write_cousins
    from pinwm_drake.report.figures.cousins import cousin_figure
    from pinwm_drake.twin.read import read_twin

    require("--number", number, 1 <= number <= _MOST, f"1 to {_MOST}")
    drawn = draw_cousins(read_twin(twin), number, delta, seed=seed, from_intervals=from_intervals)
    prepare_folder(out)
    Console().print(_table(drawn))
    write_cousins(out / COUSINS_FILE, drawn)
    cousin_figure(out / FIGURE_FILE, drawn)
    moved = sum(cousin.moved for cousin in drawn.members) / number
    say(f"{100 * moved:.1f} % of the colours were kept back to be displayable")
    for name in (COUSINS_FILE, FIGURE_FILE):
        say(f"wrote {out / name}")


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
