"""What `pinwm cousins` does."""

from pathlib import Path

from rich.console import Console
from rich.table import Table

from pinwm_drake.cousins import Cousins, draw_cousins, write_cousins
from pinwm_drake.errors import ParameterError
from pinwm_drake.files import prepare_folder
from pinwm_drake.report.figures.cousins import cousin_figure
from pinwm_drake.twin import THETA, read_twin

COUSINS_FILE, FIGURE_FILE = "cousins.npz", "cousins.png"
_MOST = 200  # pictures that a sheet can show


def run_cousins(twin: Path, out: Path, *, number: int, delta: float, from_intervals: bool, seed: int) -> None:
    """Draws cousins, writes them and their sheet, and says from which ranges they are.

    Args:
        twin: The twin's folder.
        out: Where to; made if need be.
        number: How many.
        delta: Relative half-width.
        from_intervals: Whether identified intervals are used.
        seed: Of the draws.

    Raises:
        PinwmError: An option is out of range, the twin cannot be read, or a file cannot be written.
    """
    if not 1 <= number <= _MOST:
        raise ParameterError(f"--number: got {number}; allowed: 1 to {_MOST}")
    drawn = draw_cousins(read_twin(twin), number, delta, seed=seed, from_intervals=from_intervals)
    prepare_folder(out)
    console = Console()
    console.print(_table(drawn))
    write_cousins(out / COUSINS_FILE, drawn)
    cousin_figure(out / FIGURE_FILE, drawn)
    moved = sum(cousin.moved for cousin in drawn.members) / number
    lines = [f"{100 * moved:.1f} % of the colours were kept back to be displayable"]
    lines += [f"wrote {out / name}" for name in (COUSINS_FILE, FIGURE_FILE)]
    for line in lines:
        console.print(line, highlight=False, soft_wrap=True, markup=False)


def _table(drawn: Cousins) -> Table:
    """The twin's value of each parameter, its range, and what that is from."""
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
