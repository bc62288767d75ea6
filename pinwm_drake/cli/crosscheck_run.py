"""What `pinwm crosscheck` does."""

import math
import os
from pathlib import Path

import typer
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from pinwm_drake.cli.crosscheck_report import difference_table, engine_words, remarks, write_table
from pinwm_drake.errors import InputError
from pinwm_drake.files import prepare_folder
from pinwm_drake.geometry.meshes import load_mesh
from pinwm_drake.report.figures.crosscheck import Differences, PathFrom, crosscheck_figure
from pinwm_drake.report.twin.data import read_ground_truth
from pinwm_drake.systems.crosscheck.crosscheck import PLANTS, CrossCheck, CrossCheckOptions, cross_check
from pinwm_drake.systems.scenario.load import load_setup
from pinwm_drake.systems.scenario.setup import Setup

TABLE_FILE, FIGURE_FILE = "crosscheck.csv", "crosscheck.png"
_FAILED = 1  # exit code
_WIDTH = 100  # characters, of a table that goes to a file


def run_crosscheck(
    twin: str,
    truth: Path | None,
    out: Path | None,
    *,
    engines: tuple[str, ...],
    pushes: int,
    seed: int,
    threshold_translation: float,
    threshold_rotation: float,
    processes: int | None,
) -> None:
    """Cross-checks a twin.

    Args:
        twin: Its folder, or a scenario.
        truth: `ground_truth.yaml`, or None.
        out: Folder of the results, or None.
        engines: What to compare with; empty for all.
        pushes: How many.
        seed: Of the pushes.
        threshold_translation: m.
        threshold_rotation: Degrees.
        processes: That share the pushes; None for two where there are as many cores.

    Raises:
        PinwmError: An input was refused, or a file cannot be written.
        typer.Exit: With 1, the twin does not agree.
    """
    options = CrossCheckOptions(
        engines=engines or PLANTS,
        pushes=pushes,
        seed=seed,
        threshold_translation=threshold_translation,
        threshold_rotation=math.radians(threshold_rotation),
        processes=min(2, os.cpu_count() or 1) if processes is None else processes,
    )
    setup = load_setup(twin)
    known = None if truth is None else _read_truth(truth)
    if out is not None:
        prepare_folder(out)
    console = Console()
    if not console.is_terminal:
        console = Console(width=_WIDTH)
    console.print(escape(_what(setup, truth)), highlight=False, soft_wrap=True)
    found = _with_progress(console, setup, options, known)
    console.print(difference_table(found))
    for line in remarks(found):
        console.print(line, highlight=False, soft_wrap=True, markup=False)
    for verdict in found.verdicts:
        console.print(engine_words(verdict, options), highlight=False, soft_wrap=True)
    if out is not None:
        _write(out, setup, found, _what(setup, truth))
        for name in (TABLE_FILE, FIGURE_FILE):
            console.print(f"wrote {out / name}", highlight=False, soft_wrap=True, markup=False)
    if not found.passed:
        raise typer.Exit(_FAILED)


def _read_truth(path: Path) -> dict[str, float]:
    """The true parameters; raises InputError where a file names none."""
    known = read_ground_truth(path)
    if not known:
        raise InputError(path, value="no parameter of a twin", allowed="mass, friction_floor, restitution, ...")
    return known


def _what(setup: Setup, truth: Path | None) -> str:
    """Which of the two questions is asked."""
    name = setup.scenario.name
    if truth is None:
        return f"{name}: the plants have the twin's own parameters; this checks its physics, not its parameters"
    return f"{name}: the plants have the parameters of {truth}; this checks the twin's physics and parameters"


def _with_progress(
    console: Console, setup: Setup, options: CrossCheckOptions, truth: dict[str, float] | None
) -> CrossCheck:
    columns = (TextColumn("pushes"), BarColumn(bar_width=20), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as progress:
        task = progress.add_task("pushes", total=options.pushes)
        return cross_check(setup, options, truth=truth, report=lambda: progress.advance(task))


def _write(out: Path, setup: Setup, found: CrossCheck, title: str) -> None:
    write_table(out / TABLE_FILE, found)
    worst = found.worst()
    push, options = found.pushes[worst], found.options
    crosscheck_figure(
        out / FIGURE_FILE,
        [
            Differences(
                verdict.engine,
                [one.differences[verdict.engine].translation for one in found.pushes],
                [one.differences[verdict.engine].rotation for one in found.pushes],
                verdict.passed,
            )
            for verdict in found.verdicts
        ],
        thresholds=(options.threshold_translation, options.threshold_rotation),
        mesh=load_mesh(setup.twin.mesh_path),
        worst=worst,
        paths=[PathFrom(name, motion.t, motion.p_WO, motion.q_WO) for name, motion in push.motions.items()],
        p_WP=push.motions["twin"].p_WP,
        title=title,
    )
