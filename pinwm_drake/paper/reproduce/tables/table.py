"""Tables of results, as cells that are needed and rows that are read from them."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from pinwm_drake.paper.reproduce.cell import Cell
from pinwm_drake.paper.reproduce.request import ReproduceRequest

Results = Mapping[Cell, Mapping[str, Any] | None]
"""Done cells of a table by cell, as `CellStore.read` gives them; None where one is missing."""
Row = Sequence[str]
MISSING = "not run"
NONE = "none"  # where there is no such figure


class Line(NamedTuple):
    """Row of a table, and the cells that it is read from.

    Attributes:
        head: Its first columns.
        cells: Cells of the columns between; None where there is none.
        tail: Its last columns.
    """

    head: Row
    cells: Sequence[Cell | None]
    tail: Row


@dataclass(frozen=True)
class Table:
    """A table of the paper.

    Attributes:
        columns: Columns of the cells of a line, by the results; a missing one is "not run".
        words: Explanation of what is compared, for the report.
    """

    name: str
    title: str
    header: Row
    lines: Callable[[ReproduceRequest], list[Line]]
    columns: Callable[[Sequence[Any], Results], list[str]]
    words: str

    def cells(self, request: ReproduceRequest) -> list[Cell]:
        """Cells that the rows are read from, for a request; what these need is not among them."""
        return [cell for line in self.lines(request) for cell in line.cells if cell is not None]

    def rows(self, request: ReproduceRequest, results: Results) -> list[Row]:
        """Rows for a request and the results of its cells."""
        return [[*head, *self.columns(cells, results), *tail] for head, cells, tail in self.lines(request)]
