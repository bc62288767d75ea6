"""`pinwm crosscheck`: options, a bar of the pushes, a table, and one line for each verdict."""

import math
import os
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console

from pinwm_drake.cli.console import say, stages_bar
from pinwm_drake.errors import InputError
from pinwm_drake.files import prepare_folder

if TYPE_CHECKING:
    from rich.table import Table

    from pinwm_drake.systems.crosscheck.crosscheck import CrossCheck, CrossCheckOptions, Verdict
    from pinwm_drake.systems.scenario.setup import Setup

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
    pushes: Annotated[int, typer.Option(help="How many random pushes, or pokes where the task is to flip.")] = 20,
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
    from pinwm_drake.systems.crosscheck.crosscheck import PLANTS, CrossCheckOptions, cross_check
    from pinwm_drake.systems.crosscheck.results import FIGURE_FILE, TABLE_FILE, write_crosscheck
    from pinwm_drake.systems.scenario.load import load_setup

    options = CrossCheckOptions(
        engines=(*(engine or ()), *(more or ())) or PLANTS,
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
    if setup.task.name == "flip":
        _pokes(setup, options)
        return
    question, done = _question(setup, truth), 0
    say(question)
    with stages_bar(transient=True) as show:

        def pushed() -> None:
            nonlocal done
            done += 1
            show("pushes", done / pushes, f"{done}/{pushes}")

        show("pushes", 0.0, f"0/{pushes}")
        found = cross_check(setup, options, truth=known, report=pushed)
    console = Console() if Console().is_terminal else Console(width=_WIDTH)
    console.print(_difference_table(found))
    for line in _remarks(found):
        say(line)
    for verdict in found.verdicts:
        console.print(_engine_words(verdict, options), highlight=False, soft_wrap=True)
    if out is not None:
        write_crosscheck(out, setup, found, question)
        for name in (TABLE_FILE, FIGURE_FILE):
            say(f"wrote {out / name}")
    if not found.passed:
        raise typer.Exit(_FAILED)


def _pokes(setup: "Setup", options: "CrossCheckOptions") -> None:
    """The cross-check of a scene whose task is to flip: by pokes; exits with 1 for FAIL."""
    from pinwm_drake.systems.crosscheck.pokes import poke_check

    say(f"{setup.scenario.name}: pokes that tip the object; the plants have the twin's own parameters")
    with stages_bar(transient=True) as show:
        done = 0

        def poked() -> None:
            nonlocal done
            done += 1
            show("pokes", done / options.pushes, f"{done}/{options.pushes}")

        show("pokes", 0.0, f"0/{options.pushes}")
        found = poke_check(setup, options, report=poked)
    for line in found.words():
        say(line)
    colour, word = ("green", "PASS") if found.passed else ("red", "FAIL")
    Console().print(f"[bold {colour}]{word}[/] twin", highlight=False)
    if not found.passed:
        raise typer.Exit(_FAILED)


def _read_truth(path: Path) -> dict[str, float]:
    """True values of parameters by name; raises InputError where a file names none."""
    from pinwm_drake.report.twin.data import read_ground_truth

    known = read_ground_truth(path)
    if not known:
        raise InputError(path, value="no parameter of a twin", allowed="mass, friction_floor, restitution, ...")
    return known


def _question(setup: "Setup", truth: Path | None) -> str:
    """Line that says which of two questions the cross-check asks: physics alone, or physics and parameters."""
    name = setup.scenario.name
    if truth is None:
        return f"{name}: the plants have the twin's own parameters; this checks its physics, not its parameters"
    return f"{name}: the plants have the parameters of {truth}; this checks the twin's physics and parameters"


def _difference_table(found: "CrossCheck") -> "Table":
    """Table of the differences: one row for each push and engine, the twin's first."""
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    table = Table(
        title="Twin against Drake",
        box=SIMPLE_HEAD,
        padding=(0, 1, 0, 0),
        pad_edge=False,
        caption=_CAPTION,
        caption_justify="left",
    )
    for heading in _HEADINGS:
        table.add_column(heading, justify="left" if heading == "engine" else "right", no_wrap=True)
    for number, push in enumerate(found.pushes):
        for engine, course in push.courses.items():
            apart, cells = push.differences.get(engine), [""] * 5
            if apart is not None:
                differences = (
                    _pair(apart.translation, apart.rotation),
                    _pair(apart.path_translation, apart.path_rotation),
                )
                cells = [*differences[0], *differences[1], f"{100 * apart.same_modes:.0f}"]
            motion = _pair(course.moved, course.turned)
            contact = [" ".join(f"{100 * share:.0f}" for share in shares) for shares in (course.floor, course.pusher)]
            name = str(number) if engine == "twin" else ""
            table.add_row(name, engine, *motion, *cells, *contact, f"{1e3 * course.energy_stop:.2f}")
        table.add_section()
    return table


_HEADINGS = (
    *("push", "engine", "moves\nmm", "turns\n°", "apart\nmm", "apart\n°", "path\nmm", "path\n°", "same\n%"),
    *("floor\n%", "pusher\n%", "energy\nmJ"),
)
_CAPTION = """apart: from the twin, after rest; path: at most on the way
floor, pusher: share of the time until rest in which the pair is separated, sticks, slides
same: share of the time in which twin and engine agree in both
energy: kinetic, when the pusher stopped"""


def _remarks(found: "CrossCheck") -> Iterator[str]:
    """Remarks on motions that failed, did not come to rest or gained energy, one line for each push and engine."""
    for number, push in enumerate(found.pushes):
        for engine, course in push.courses.items():
            if course.words():
                yield f"push {number}, {engine}: {course.words()}"


def _engine_words(verdict: "Verdict", options: "CrossCheckOptions") -> str:
    """Verdict on an engine in one line, in rich's markup."""
    limits = f"{_millimetres(options.threshold_translation)} and {_degrees(options.threshold_rotation)}"
    medians = f"{_millimetres(verdict.median_translation, 2)}, {_degrees(verdict.median_rotation, 2)}"
    most = f"{_millimetres(verdict.most_translation)}, {_degrees(verdict.most_rotation)}"
    colour, word = ("green", "PASS") if verdict.passed else ("red", "FAIL")
    line = f"[bold {colour}]{word}[/] {verdict.engine}: median of {options.pushes} pushes {medians} (at most {most}); "
    line += f"threshold of the medians {limits}"
    if verdict.unsound:
        line += f"; {verdict.unsound} failed or did not come to rest"
    if verdict.rising:
        line += f"; in {verdict.rising} energy rose after the pusher had stopped"
    return line


def _pair(translation: float, rotation: float) -> tuple[str, str]:
    """Texts of a translation [m] and a rotation [rad] in mm and degrees."""
    return f"{1e3 * translation:.1f}", f"{math.degrees(rotation):.1f}"


def _millimetres(value: float, digits: int = 1) -> str:
    return f"{1e3 * value:.{digits}f} mm"


def _degrees(value: float, digits: int = 1) -> str:
    return f"{math.degrees(value):.{digits}f}°"
