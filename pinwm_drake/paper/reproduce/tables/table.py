"""Tables of results, as cells that are needed and rows that are read from them."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from pinwm_drake.paper.reproduce.cell import Cell
from pinwm_drake.paper.reproduce.request import ReproduceRequest

Results = Mapping[Cell, Mapping[str, Any] | None]
"""Done cells of a table by cell, as `CellStore.read` gives them; None where one is missing."""
Row = Sequence[str]


@dataclass(frozen=True)
class Table:
    """A table of the paper.

    Attributes:
        name: Name on the command line.
        title: Heading.
        header: Names of the columns.
        cells: Cells that the rows are read from, for a request; what these need is not among them.
        rows: Rows for a request and the results of its cells; a missing one is "not run".
        words: Explanation of what is compared, for the report.
    """

    name: str
    title: str
    header: Row
    cells: Callable[[ReproduceRequest], list[Cell]]
    rows: Callable[[ReproduceRequest, Results], list[Row]]
    words: str


MISSING = "not run"


def percent(share: float) -> str:
    """Share as a percentage, "97 %"."""
    return f"{100.0 * share:.3g} %"
