"""The files of a cross-check: crosscheck.csv and crosscheck.png."""

import csv
from collections.abc import Iterator
from pathlib import Path

from pinwm_drake.files import prepare_folder, replacing
from pinwm_drake.geometry.meshes import load_mesh
from pinwm_drake.report.figures.crosscheck import Differences, crosscheck_figure
from pinwm_drake.systems.crosscheck.crosscheck import CrossCheck, PushResult
from pinwm_drake.systems.crosscheck.motion import MODES
from pinwm_drake.systems.scenario.setup import Setup

TABLE_FILE, FIGURE_FILE = "crosscheck.csv", "crosscheck.png"
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


def write_crosscheck(out: Path, setup: Setup, found: CrossCheck, title: str) -> None:
    """Writes table and figure of a cross-check.

    Args:
        out: Folder of the files; made if need be.
        setup: The scene of the twin.
        found: The cross-check.
        title: Title of the figure.

    Raises:
        InputError: A file cannot be written.
    """
    prepare_folder(out)
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
        paths={name: (motion.p_WO, motion.q_WO) for name, motion in push.motions.items()},
        p_WP=push.motions["twin"].p_WP,
        title=title,
    )


def write_table(path: Path, found: CrossCheck) -> None:
    """Writes a row for each push and engine, the twin's first.

    SI units, radians, world frame; shares of time from 0 to 1.

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
