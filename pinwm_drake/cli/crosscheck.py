"""`pinwm crosscheck`: options, a bar of the pushes, a table, and one line for each verdict."""

import math
import os
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from pinwm_drake.cli.console import say, stages_bar
from pinwm_drake.errors import InputError
from pinwm_drake.files import prepare_folder

_FAILED = 1  # exit code
_WIDTH = 100  # characters, of a table that goes to a file


def crosscheck(
    twin: Annotated[
        str, typer.Argument(metavar="TWIN", help="Folder that `pinwm identify` wrote, or a .scenario.yaml file.")
    ],
    more: Annotated[
        list[str] | None, typer.Argument(metavar="ENGINE", help="Further engines: --engine hydroelastic point.")
    ] = None,
    engine: Annotated[
        list[str] | None,
        typer.Option(help="Drake's contact model to compare with.", show_default="hydroelastic and point"),
    ] = None,
    pushes: Annotated[
        int, typer.Option(help="Number of random pushes; of pokes where the recipe of the scene's task has these.")
    ] = 20,
    seed: Annotated[int, typer.Option(help="Of the pushes.")] = 0,
    truth: Annotated[
        Path | None,
        typer.Option(
            help="ground_truth.yaml of a simulated capture: the plants have the true parameters, which checks "
            "the identified ones.",
            show_default="the plants have those of the twin, which checks the physics",
        ),
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="Folder for crosscheck.csv and crosscheck.png.")
    ] = None,
    threshold_translation: Annotated[
        float, typer.Option(help="In m, for the median difference of the object's place after rest.")
    ] = 0.003,
    threshold_rotation: Annotated[float, typer.Option(help="In degrees, likewise of its orientation.")] = 2.0,
    processes: Annotated[
        int | None, typer.Option(help="That share the pushes.", show_default="2, or 1 on one core")
    ] = None,
) -> None:
    """Sends the same pushes through a twin and Drake's own contact; exits with 0 for PASS and with 1 for FAIL."""
    from pinwm_drake.report.twin.data import read_ground_truth
    from pinwm_drake.systems.crosscheck.crosscheck import cross_check
    from pinwm_drake.systems.crosscheck.options import PLANTS, CrossCheckOptions
    from pinwm_drake.systems.scenario.load import load_setup
    from pinwm_drake.tasks.registry import recipe_of

    options = CrossCheckOptions(
        engines=(*(engine or ()), *(more or ())) or PLANTS,
        pushes=pushes,
        seed=seed,
        threshold_translation=threshold_translation,
        threshold_rotation=math.radians(threshold_rotation),
        processes=min(2, os.cpu_count() or 1) if processes is None else processes,
    )
    setup = load_setup(twin)
    known = None if truth is None else read_ground_truth(truth)
    if truth is not None and not known:
        raise InputError(truth, value="no parameter of a twin", allowed="mass, friction_floor, restitution, ...")
    if out is not None:
        prepare_folder(out)
    question = f"{setup.scenario.name}: the plants have "
    if truth is None:
        question += "the twin's own parameters; this checks its physics, not its parameters"
    else:
        question += f"the parameters of {truth}; this checks the twin's physics and parameters"
    say(question)
    motions, done = recipe_of(setup.task).check, 0
    with stages_bar(transient=True) as show:

        def moved() -> None:
            nonlocal done
            done += 1
            show(motions, done / pushes, f"{done}/{pushes}")

        show(motions, 0.0, f"0/{pushes}")
        found = cross_check(setup, options, truth=known, report=moved)
    console = Console() if Console().is_terminal else Console(width=_WIDTH)
    if (table := found.table()) is not None:
        console.print(table)
    for line in found.words():
        say(line)
    for passed, words in found.results():
        colour, word = ("green", "PASS") if passed else ("red", "FAIL")
        console.print(f"[bold {colour}]{word}[/] {words}", highlight=False, soft_wrap=True)
    if out is not None:
        for path in found.write(out, setup, question):
            say(f"wrote {path}")
    if not found.passed:
        raise typer.Exit(_FAILED)
