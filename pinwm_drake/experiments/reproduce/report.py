"""The report of a reproduction, from the folders of its cells alone."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pinwm_drake.experiments.reproduce.cell import Cell, CellStore, in_order
from pinwm_drake.experiments.reproduce.figures import table_figures
from pinwm_drake.experiments.reproduce.request import ReproduceRequest
from pinwm_drake.experiments.reproduce.tables.table import MISSING, Row, Table
from pinwm_drake.files import prepare_folder, replacing


def read_results(tables: Sequence[Table], request: ReproduceRequest, root: Path) -> dict[Cell, dict[str, Any] | None]:
    """Results of the cells of tables, None for those that are not made.

    Raises:
        InputError: A cell of other settings is in the folder, or a file cannot be read.
    """
    store = CellStore(root)
    return {cell: store.read(cell) for table in tables for cell in table.cells(request)}


def write_report(path: Path, tables: Sequence[Table], request: ReproduceRequest, root: Path) -> None:
    """Writes tables in Markdown, with where and when all that they need was made, and figures of them beside the file.

    Args:
        path: File; figures have its stem and the table's name.
        tables: The tables.
        request: Tasks, systems and seeds; cells that are not made are "not run".
        root: Folder of the experiment.

    Raises:
        InputError: A cell of other settings is in the folder, or a file cannot be written.
    """
    store, waves = CellStore(root), in_order(cell for table in tables for cell in table.cells(request))
    results = {cell: store.read(cell) for wave in waves for cell in wave}
    prepare_folder(path.parent)
    parts = ["# The paper's tables", f"Written by `pinwm reproduce report` from the folders of {root.name}."]
    for table in tables:
        rows = _listed(table.header, table.rows(request, results))
        parts += [f"## {table.title}", table.words, markdown(table.header, rows)]
        for name, figure in table_figures(table, request, results).items():
            picture = path.with_name(f"{path.stem}-{name}.png")
            with replacing(picture) as temporary:
                figure.savefig(temporary)
            parts.append(f"![{table.title}]({picture.name})")
    ended = [done["provenance"] for done in results.values() if done is not None]
    made = [run for one in ended for run in one.get("runs", [one])]
    if made:
        commits = sorted({one["commit"] or "no repository" for one in made})
        machines = sorted({one["machine"] for one in made})
        first, last = (pick(one["time"] for one in made) for pick in (min, max))
        parts.append(f"Commits {', '.join(commits)}; machines: {'; '.join(machines)}; {first} to {last}.")
    with replacing(path) as temporary:
        temporary.write_text("\n\n".join(parts) + "\n", encoding="utf-8")


def _listed(header: Row, rows: Sequence[Row]) -> list[Row]:
    """Rows of a report: those of seeds after the first one only where they were run."""
    if "seed" not in header:
        return list(rows)
    at = header.index("seed")
    return [row for row in rows if row[at] in ("", "0") or MISSING not in row]


def markdown(header: Row, rows: Sequence[Row]) -> str:
    """Table in Markdown."""
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)
