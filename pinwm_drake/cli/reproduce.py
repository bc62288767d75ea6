# SPDX-License-Identifier: MIT
"""`pinwm reproduce`: the plan of the paper's tables, their cells as they are made, and the report."""

from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pinwm_drake.cli.console import say, stages_bar
from pinwm_drake.errors import InputError, PinwmError
from pinwm_drake.paper.reproduce.request import REPORT, ReproduceRun

if TYPE_CHECKING:
    from pinwm_drake.paper.reproduce.cell import Cell
    from pinwm_drake.paper.reproduce.run import Plan


def reproduce(request: ReproduceRun) -> None:
    """Make the paper's tables; a second run goes on.

    Captures, twins, policies and evaluations are cells, each of which is made once. The tables are policies, one-step,
    randomization, parameters, geometry-noise, tasks and stand-in; report writes those that are made.
    """
    from pinwm_drake.kernel_cache import announce_compiling
    from pinwm_drake.paper.reproduce.run import plan, seeds_of, tables_of, write_report
    from pinwm_drake.paper.reproduce.run import reproduce as run
    from pinwm_drake.parallel import Executor

    out, work, reports = request.out, request.resolved(), REPORT in request.tables
    if reports and request.seeds is None:
        work = replace(work, seeds=seeds_of(out))
    tables = tables_of([name for name in request.tables if name != REPORT] or ["all"])
    file = request.report or out / "report.md"
    if reports:
        write_report(file, tables, work, out)
        say(f"wrote {file}")
        return
    processes = Executor(request.executor, workers=request.workers)
    planned = plan(tables, work, out)
    _show(planned)
    if not request.resume and (there := sum((out / cell.key).exists() for wave in planned.waves for cell in wave)):
        raise InputError(out, value=f"{there} cells that are made or begun", allowed="a new folder, or --resume")
    if request.plan_only:
        return

    cells = [cell for wave in planned.waves for cell in wave]
    hours, made = sum(cell.hours for cell in cells), list[float]()

    def share() -> float:
        """Share of the work that is done, that of earlier runs among it."""
        return min(max(hours - planned.hours, sum(made)) / max(hours, 1e-9), 1.0)

    try:
        announce_compiling()
        with stages_bar(transient=True) as show:
            show("reproducing", share(), f"{sum(planned.done)}/{len(cells)} cells")

            def told(cell: "Cell", done: dict[str, Any]) -> None:
                made.append(cell.hours)
                say(f"{cell.key}: {done['provenance']['minutes']:g} min  {_short(cell, done['result'])}")
                show("reproducing", share(), f"{max(len(made), sum(planned.done))}/{len(cells)} cells")

            run(tables, work, out, executor=processes, on_cell=told)
    except KeyboardInterrupt:
        kept = f"; the same command goes on (what is done is in {out})" if _has_cells(out, cells) else ""
        say(f"interrupted{kept}")
        raise SystemExit(1) from None
    except PinwmError:
        with suppress(PinwmError):
            write_report(file, tables, work, out)  # of what there is
        raise
    write_report(file, tables, work, out)
    say(f"wrote {file}")


def _has_cells(out: Path, cells: "list[Cell]") -> bool:
    return any((out / cell.key).exists() for cell in cells)


def _show(planned: "Plan") -> None:
    """Print the plan: the cells of each wave, how many are made, and what the rest takes."""
    for wave, done in zip(planned.waves, planned.done, strict=True):
        for cell in wave:
            say(f"  {cell.key}  (about {cell.hours:.2f} h)")
        say(f"{done} of {len(wave)} are made")
    say(f"about {planned.hours:.1f} h of one core are left; lines on what goes on are in logs/")


def _short(cell: "Cell", result: dict[str, Any]) -> str:
    """Return the result of a cell in a few words."""
    if "success_rate" in result:
        return f"success {result['success_rate']:.0%}"
    if "theta" in result:
        name = getattr(cell, "only", "") or "friction_floor"
        return f"{name} {result['theta'][name]:.4g}"
    return ""
