"""`pinwm reproduce`: the plan of the paper's tables, their cells as they are made, and the report."""

from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from pinwm_drake.cli.console import say
from pinwm_drake.errors import InputError, PinwmError

if TYPE_CHECKING:
    from pinwm_drake.paper.reproduce.cell import Cell
    from pinwm_drake.paper.reproduce.run import Plan

REPORT = "report"


def reproduce(
    table: Annotated[
        list[str],
        typer.Argument(
            metavar="TABLE...",
            help="policies, one-step, randomization, parameters, geometry-noise, tasks, stand-in, all; report writes.",
        ),
    ],
    out: Annotated[
        Path, typer.Option("--out", "-o", help="Folder of the cells; what is made in it is not made again.")
    ] = Path("out/reproduce"),
    task: Annotated[
        list[str] | None,
        typer.Option(help="push or flip (or push-cube, push-large-t, flip-cube); repeat it.", show_default="both"),
    ] = None,
    methods: Annotated[
        str, typer.Option(help="Names of systems with commas between them, or all: those of the table.")
    ] = "all",
    seeds: Annotated[
        int | None,
        typer.Option(
            help="How many, from 0 on: each with a capture of its own.", show_default="1; of a report those there are"
        ),
    ] = None,
    episodes: Annotated[int, typer.Option(help="Of each evaluation.")] = 100,
    draws: Annotated[int, typer.Option(help="Actions of one-step errors.")] = 200,
    quick: Annotated[
        bool,
        typer.Option(
            "--quick", help="Run everything on tiny budgets, one episode and three draws: shows that it works, no more."
        ),
    ] = False,
    executor: Annotated[str, typer.Option(help="joblib, or ray.")] = "joblib",
    workers: Annotated[int | None, typer.Option(help="Processes.", show_default="one on each core")] = None,
    plan_only: Annotated[bool, typer.Option("--plan", help="Print the plan and end.")] = False,
    resume: Annotated[
        bool, typer.Option("--resume/--no-resume", help="Take what is made in the folder; else nothing may be there.")
    ] = True,
    report: Annotated[
        Path | None, typer.Option(help="File of the report.", show_default="report.md in the folder of the cells")
    ] = None,
) -> None:
    """Makes the paper's tables: captures, twins, policies, evaluations, each once; after a kill it goes on."""
    from pinwm_drake.paper.reproduce.report import write_report
    from pinwm_drake.paper.reproduce.request import ReproduceRequest
    from pinwm_drake.paper.reproduce.run import plan, reproduce, seeds_of, tables_of
    from pinwm_drake.parallel import Executor

    reports = REPORT in table
    if seeds is None:
        seeds = seeds_of(out) if reports else 1
    options: dict[str, Any] = {"seeds": seeds, "episodes": episodes, "draws": draws, "quick": quick}
    if task:
        options["tasks"] = tuple(task)
    names = tuple(name.strip() for name in methods.split(","))
    if "all" not in names:
        options["methods"] = names
    request = ReproduceRequest(**options)
    if quick:
        request = replace(request, episodes=1, draws=min(draws, 3))
    tables = tables_of([name for name in table if name != REPORT] or ["all"])
    file = report or out / "report.md"
    if reports:
        write_report(file, tables, request, out)
        say(f"wrote {file}")
        return
    processes = Executor(executor, workers=workers)
    planned = plan(tables, request, out)
    _show(planned)
    if not resume and (there := sum((out / cell.key).exists() for wave in planned.waves for cell in wave)):
        raise InputError(out, value=f"{there} cells that are made or begun", allowed="a new folder, or --resume")
    if plan_only:
        return

    def told(cell: "Cell", done: dict[str, Any]) -> None:
        say(f"{cell.key}: {done['provenance']['minutes']:g} min  {_short(cell, done['result'])}")

    try:
        reproduce(tables, request, out, executor=processes, on_cell=told)
    except KeyboardInterrupt:
        say(f"interrupted; the same command goes on (what is done is in {out})")
        raise SystemExit(1) from None
    except PinwmError:
        with suppress(PinwmError):
            write_report(file, tables, request, out)  # of what there is
        raise
    write_report(file, tables, request, out)
    say(f"wrote {file}")


def _show(planned: "Plan") -> None:
    """Prints the plan: the cells of each wave, how many are made, and what the rest takes."""
    for wave, done in zip(planned.waves, planned.done, strict=True):
        for cell in wave:
            say(f"  {cell.key}  (about {cell.hours:.2f} h)")
        say(f"{done} of {len(wave)} are made")
    say(f"about {planned.hours:.1f} h of one core are left; lines on what goes on are in logs/")


def _short(cell: "Cell", result: dict[str, Any]) -> str:
    """Result of a cell in a few words."""
    if "success_rate" in result:
        return f"success {result['success_rate']:.0%}"
    if "theta" in result:
        name = getattr(cell, "only", "") or "friction_floor"
        return f"{name} {result['theta'][name]:.4g}"
    return ""
