# SPDX-License-Identifier: MIT
"""The reproduction of tables: its plan, its cells, and its report, from the folders of its cells alone."""

import traceback
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from pinwm_drake.errors import InputError, ParameterError, PinwmError
from pinwm_drake.files import prepare_folder, replacing
from pinwm_drake.paper.reproduce.cell import DONE_FILE, Cell, CellStore, in_order, log_path, made
from pinwm_drake.paper.reproduce.figures import table_figures
from pinwm_drake.paper.reproduce.request import ReproduceRequest
from pinwm_drake.paper.reproduce.tables import (
    GEOMETRY_NOISE,
    MISSING,
    ONE_STEP,
    PARAMETERS,
    POLICIES,
    RANDOMIZATION,
    STAND_IN,
    TASKS_TABLE,
    Row,
    Table,
)
from pinwm_drake.parallel import Executor
from pinwm_drake.provenance import timestamp


def read_results(tables: Sequence[Table], request: ReproduceRequest, root: Path) -> dict[Cell, dict[str, Any] | None]:
    """Results of the cells of tables, None for those that are not made.

    Raises:
        InputError: A cell of other settings is in the folder, or a file cannot be read.
    """
    store = CellStore(root)
    return {cell: store.read(cell) for table in tables for cell in table.cells(request)}


def write_report(path: Path, tables: Sequence[Table], request: ReproduceRequest, root: Path) -> None:
    """Write tables in Markdown, with where and when all that they need was made, and figures of them beside the file.

    Args:
        path: File; figures have its stem and the table's name.
        tables: The tables.
        request: Tasks, systems and seeds; cells that are not made are "not run".
        root: Folder of the experiment.

    Raises:
        InputError: None of the cells is in the folder, or one of other settings; or a file cannot be written.
    """
    store = CellStore(root)
    needed = {table.name: [cell for wave in in_order(table.cells(request)) for cell in wave] for table in tables}
    results = {cell: store.read(cell) for cells in needed.values() for cell in cells}
    if not any(results.values()):
        raise InputError(root, value="none of the cells of these tables", allowed="a folder of `pinwm reproduce`")
    prepare_folder(path.parent)
    parts = ["# The paper's tables", f"`pinwm reproduce report` writes this page from the cells in `{root.name}`."]
    if request.quick:
        parts.append("**Made with `--quick`**: tiny budgets show that everything runs. The figures mean nothing.")
    for table in tables:
        rows = listed(table.header, table.rows(request, results))
        parts += [f"## {table.title}", table.words, markdown(table.header, rows)]
        for name, figure in table_figures(table, request, results).items():
            picture = path.with_name(f"{path.stem}-{name}.png")
            with replacing(picture) as temporary:
                figure.savefig(temporary)
            parts.append(f"![{table.title}]({picture.name})")
        parts += _origin([done for cell in needed[table.name] if (done := results[cell]) is not None])
    with replacing(path) as temporary:
        temporary.write_text("\n\n".join(parts) + "\n", encoding="utf-8")


def _origin(results: Sequence[Mapping[str, Any]]) -> list[str]:
    """Words on where, when and in what time the cells of a table were made; none where there are none."""
    if not results:
        return []
    ended = [done["provenance"] for done in results]
    made = [run for one in ended for run in one.get("runs", [one])]
    episodes = sorted({done["result"]["episodes"] for done in results if "success_rate" in done["result"]})
    counts = f"; {' or '.join(map(str, episodes))} episodes of each evaluation" if episodes else ""
    commits = sorted({one["commit"] or "no repository" for one in made})
    machines = sorted({one["machine"] for one in made})
    first, last = (pick(one["time"] for one in made) for pick in (min, max))
    hours = sum(one["minutes"] for one in ended) / 60.0
    return [
        f"{len(results)} cells in {hours:.3g} h, those that other tables share included{counts}. Commits "
        f"{', '.join(commits)}; machines: {'; '.join(machines)}; {first} to {last}."
    ]


def listed(header: Row, rows: Sequence[Row]) -> list[Row]:
    """Rows of a report: those of seeds after the first one only where they were run."""
    if "seed" not in header:
        return list(rows)
    at = header.index("seed")
    return [row for row in rows if row[at] in ("", "0") or MISSING not in row]


def markdown(header: Row, rows: Sequence[Row]) -> str:
    """Table in Markdown."""
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


_ALL = (POLICIES, ONE_STEP, RANDOMIZATION, PARAMETERS, GEOMETRY_NOISE, TASKS_TABLE, STAND_IN)
TABLES = {table.name: table for table in _ALL}


@dataclass(frozen=True)
class Plan:
    """All cells of a reproduction, in waves, and which of them are made.

    Attributes:
        waves: Cells: those of a wave need none but those of the waves before.
        hours: h of one core, estimated, of the cells that are not made.
    """

    waves: list[list[Cell]]
    done: list[int]
    hours: float


def tables_of(names: Sequence[str]) -> list[Table]:
    """Tables by name; all of them for "all".

    Raises:
        ParameterError: There is no such table.
    """
    for name in names:
        if name not in (*TABLES, "all"):
            raise ParameterError(f"TABLE: got {name!r}; allowed: all, {', '.join(TABLES)}")
    return list(TABLES.values()) if "all" in names else [TABLES[name] for name in dict.fromkeys(names)]


def plan(tables: Sequence[Table], request: ReproduceRequest, root: Path) -> Plan:
    """Plan of tables.

    Raises:
        InputError: A cell of other settings is in the folder.
        ParameterError: No system that is asked for is in the tables.
    """
    store = CellStore(root)
    waves = in_order(cell for table in tables for cell in table.cells(request))
    if not waves:
        names = ", ".join(table.name for table in tables)
        asked = ", ".join(request.methods or ())
        raise ParameterError(f"--methods: got {asked}, none of which is in {names}; allowed: systems of these tables")
    left = [[cell for cell in wave if store.read(cell) is None] for wave in waves]
    done = [len(wave) - len(missing) for wave, missing in zip(waves, left, strict=True)]
    return Plan(waves, done, sum(cell.hours for missing in left for cell in missing))


def seeds_of(root: Path) -> int:
    """Return the number of seeds, from 0 on, of which there are cells in a folder; 1 where there are none."""
    found = [path.parent.name.removeprefix("seed-") for path in root.rglob(f"seed-*/{DONE_FILE}")]
    return 1 + max((int(name) for name in found if name.isdigit()), default=0)


def reproduce(
    tables: Sequence[Table],
    request: ReproduceRequest,
    root: Path,
    *,
    executor: Executor | None = None,
    on_cell: Callable[[Cell, dict[str, Any]], None] = lambda cell, done: None,
) -> None:
    """Make all cells of tables that are not made yet; those that a run left that was killed go on.

    Args:
        executor: Processes that share the cells; None for one on each core.
        on_cell: Called with each cell that is made, and its result.

    Raises:
        CellError: A cell could not be made; what does not need it is done.
        PinwmError: Several could not be made; a cell of other settings is there; or the folder cannot be used.
    """
    root = prepare_folder(root).absolute()  # a worker may be in another folder
    cells = [cell for wave in plan(tables, request, root).waves for cell in wave]
    (executor or Executor()).map(
        partial(_make, root),
        cells,
        needs=lambda cell: cell.needs,
        store=CellStore(root),
        on_result=on_cell,
        keep_going=True,
    )


class CellError(PinwmError):
    """A cell that could not be made; the message names it, and what was in the way."""


def _make(root: Path, cell: Cell) -> dict[str, Any]:
    """Make a cell; when it began and ended, and what it tells on the way, stands in a log.

    Raises:
        CellError: It cannot be made, whatever the reason: others go on. The log has the traceback.
    """
    log = log_path(root, cell, ".txt")
    prepare_folder(log.parent)

    def say(line: str) -> None:
        with log.open("a", encoding="utf-8") as file:
            file.write(f"{timestamp()} {line}\n")

    say("begun")
    try:
        done = made(cell, root, say)
    except Exception as error:
        say("".join(traceback.format_exception(error)))
        what = str(error) if isinstance(error, PinwmError) else f"{type(error).__name__}: {error}"
        raise CellError(f"{cell.key}: {what} (log: {log})") from error
    say(f"made in {done['provenance']['minutes']:g} minutes")
    return done
