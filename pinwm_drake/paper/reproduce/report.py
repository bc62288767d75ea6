"""The report of a reproduction, from the folders of its cells alone."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pinwm_drake.errors import InputError
from pinwm_drake.files import prepare_folder, replacing
from pinwm_drake.paper.reproduce.cell import Cell, CellStore, in_order
from pinwm_drake.paper.reproduce.figures import table_figures
from pinwm_drake.paper.reproduce.request import ReproduceRequest
from pinwm_drake.paper.reproduce.tables.table import MISSING, Row, Table


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
        InputError: None of the cells is in the folder, or one of other settings; or a file cannot be written.
    """
    store = CellStore(root)
    needed = {table.name: [cell for wave in in_order(table.cells(request)) for cell in wave] for table in tables}
    results = {cell: store.read(cell) for cells in needed.values() for cell in cells}
    if not any(results.values()):
        raise InputError(root, value="none of the cells of these tables", allowed="a folder of `pinwm reproduce`")
    prepare_folder(path.parent)
    parts = ["# The paper's tables", f"Written by `pinwm reproduce report` from the folders of {root.name}."]
    if request.quick:
        parts.append("**Made with `--quick`**: tiny budgets, to show that everything runs. The figures mean nothing.")
    for table in tables:
        rows = _listed(table.header, table.rows(request, results))
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
        f"{len(results)} cells in {hours:.3g} h, what other tables share among them{counts}. Commits "
        f"{', '.join(commits)}; machines: {'; '.join(machines)}; {first} to {last}."
    ]


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
