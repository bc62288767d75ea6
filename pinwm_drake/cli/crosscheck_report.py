"""A cross-check in words and numbers: the table on the console, crosscheck.csv, and one line for each verdict."""

import csv
import math
from collections.abc import Iterator
from pathlib import Path

from rich.box import SIMPLE_HEAD
from rich.table import Table

from pinwm_drake.files import replacing
from pinwm_drake.systems.crosscheck.crosscheck import CrossCheck, CrossCheckOptions, PushResult, Verdict
from pinwm_drake.systems.crosscheck.motion import MODES

_PUSH = (
    *("push", "start_x", "start_y", "start_z", "start_qw", "start_qx", "start_qy", "start_qz"),
    *("pusher_x", "pusher_y", "pusher_z", "direction_x", "direction_y", "speed", "distance", "engine"),
)
_DIFFERENCE = ("translation", "rotation", "path_translation", "path_rotation", "same_modes")
_COURSE = (
    *("moved", "turned", "rest_time", "energy_peak", "energy_stop", "energy_rise"),
    *(f"{pair}_{mode}" for pair in ("floor", "pusher") for mode in MODES),
)
COLUMNS = (*_PUSH, *_DIFFERENCE, *_COURSE, "failure")


def write_table(path: Path, found: CrossCheck) -> None:
    """One row for each push and engine, the twin's first. SI units, radians, world frame; shares of time from 0 to 1.

    Raises:
        InputError: The file cannot be written.
    """
    with replacing(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(COLUMNS)
        for number, push in enumerate(found.pushes):
            writer.writerows(_rows(number, push))


def _rows(number: int, result: PushResult) -> Iterator[list[str]]:
    X_WO, push = result.trial.X_WO, result.trial.push
    place = [*X_WO.translation(), *X_WO.rotation().ToQuaternion().wxyz(), *push.p_WP, *push.direction_W[:2]]
    start = [str(number), *_numbers([*place, push.speed, push.distance])]
    for engine, course in result.courses.items():
        difference = result.differences.get(engine)
        apart = [""] * len(_DIFFERENCE)
        if difference is not None:
            apart = _numbers([getattr(difference, name) for name in _DIFFERENCE])
        energies = [course.energy_peak, course.energy_stop, course.energy_rise]
        own = _numbers([course.moved, course.turned, course.rest_time, *energies, *course.floor, *course.pusher])
        yield [*start, engine, *apart, *own, course.failure]


def _numbers(values: list[float]) -> list[str]:
    return [f"{value:.9g}" for value in values]


def difference_table(found: CrossCheck) -> Table:
    """One row for each push and engine, the twin's first, for the console."""
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


def remarks(found: CrossCheck) -> Iterator[str]:
    """What went wrong in an engine, one line for each push and engine."""
    for number, push in enumerate(found.pushes):
        for engine, course in push.courses.items():
            if course.words():
                yield f"push {number}, {engine}: {course.words()}"


def engine_words(verdict: Verdict, options: CrossCheckOptions) -> str:
    """A verdict in one line, in rich's markup."""
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
    """In mm and degrees."""
    return f"{1e3 * translation:.1f}", f"{math.degrees(rotation):.1f}"


def _millimetres(value: float, digits: int = 1) -> str:
    return f"{1e3 * value:.{digits}f} mm"


def _degrees(value: float, digits: int = 1) -> str:
    return f"{math.degrees(value):.{digits}f}°"
