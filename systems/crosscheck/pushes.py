# SPDX-License-Identifier: MIT
"""Comparison of a twin with Drake's own contact models by equal pushes: by where the object comes to rest."""

import csv
import math
from collections.abc import Iterator, Sequence
from dataclasses import astuple, dataclass, field, fields
from pathlib import Path

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.table import Table

from pinwm_drake.files import prepare_folder, replacing
from pinwm_drake.geometry.meshes import load_mesh
from pinwm_drake.report.figures.crosscheck import Differences, crosscheck_figure
from pinwm_drake.systems.crosscheck.alike import TWIN, Effect, alike, effects, like, median
from pinwm_drake.systems.crosscheck.difference import Course, Difference, course_of, difference_of
from pinwm_drake.systems.crosscheck.motion import MODES, Cases, Motion
from pinwm_drake.systems.crosscheck.options import CrossCheckOptions
from pinwm_drake.systems.crosscheck.trials import Trial
from pinwm_drake.systems.scenario.setup import Setup

TABLE_FILE, FIGURE_FILE = "crosscheck.csv", "crosscheck.png"
_PUSH = (
    *("push", "start_x", "start_y", "start_z", "start_qw", "start_qx", "start_qy", "start_qz"),
    *("pusher_x", "pusher_y", "pusher_z", "direction_x", "direction_y", "speed", "distance", "engine"),
)
_DIFFERENCE = tuple(field.name for field in fields(Difference))
_COURSE = (
    *("moved", "turned", "rest_time", "energy_peak", "energy_stop", "energy_rise"),
    *(f"{pair}_{mode}" for pair in ("floor", "pusher") for mode in MODES),
)
COLUMNS = (*_PUSH, *_DIFFERENCE, *_COURSE, "failure")
_HEADINGS = (
    *("push", "engine", "moves\nmm", "turns\n°", "apart\nmm", "apart\n°", "path\nmm", "path\n°", "same\n%"),
    *("floor\n%", "pusher\n%", "energy\nmJ"),
)
_CAPTION = """apart: from the twin, or the twin like the engine, after rest; path: at most on the way
floor, pusher: share of the time until rest in which the pair is separated, sticks, slides
same: share of the time in which twin and engine agree in both
energy: kinetic, when the pusher stopped"""


@dataclass(frozen=True, eq=False)
class PushComparison:
    """A push in all engines: motions, summaries and differences from the twin by the engine's name.

    Motions and summaries are those of the twin as each plant has it, too; see `alike.py`. Differences are from it.
    """

    trial: Trial
    motions: dict[str, Motion]
    courses: dict[str, Course]
    differences: dict[str, Difference]


@dataclass(frozen=True)
class Verdict:
    """Verdict on the twin against one engine, which passes where both medians keep their thresholds.

    Attributes:
        engine: Name of the engine.
        median_translation: m, median of the differences after rest.
        median_rotation: rad, median of the differences after rest.
        most_translation: m, largest difference after rest.
        most_rotation: rad, largest difference after rest.
        unsound: Number of pushes that failed or did not come to rest in the twin or in this engine; their difference
            is infinite.
        rising: Number of pushes in which energy came from nowhere, in the twin or in this engine.
        passed: Flag: the twin agrees with the engine.
    """

    engine: str
    median_translation: float
    median_rotation: float
    most_translation: float
    most_rotation: float
    unsound: int
    rising: int
    passed: bool

    def words(self, options: CrossCheckOptions) -> str:
        """Return the verdict in one line."""
        most = _pair(self.most_translation, self.most_rotation)
        limits = _pair(*options.limits)
        line = f"{self.engine}: median of {options.pushes} pushes {1e3 * self.median_translation:.2f} mm, "
        line += f"{math.degrees(self.median_rotation):.2f}° (at most {most[0]} mm, {most[1]}°); "
        line += f"threshold of the medians {limits[0]} mm and {limits[1]}°"
        if self.unsound:
            line += f"; {self.unsound} failed or did not come to rest"
        if self.rising:
            line += f"; in {self.rising} energy rose after the pusher had stopped"
        return line


@dataclass(frozen=True, eq=False)
class PushCheck:
    """Results of a cross-check by pushes, in the order of the draw, and the verdict on each engine."""

    options: CrossCheckOptions
    pushes: list[PushComparison]
    verdicts: list[Verdict]
    effects: list[Effect] = field(default_factory=list)  # of parameters that plants do not take over

    @property
    def passed(self) -> bool:
        """Flag: the twin agrees with every engine."""
        return all(verdict.passed for verdict in self.verdicts)

    def table(self) -> Table:
        """Table of the differences: one row for each push and engine, the twin's first."""
        table = Table(title="Twin against Drake", caption=_CAPTION, caption_justify="left")
        table.box, table.padding, table.pad_edge = SIMPLE_HEAD, (0, 1, 0, 0), False
        for heading in _HEADINGS:
            table.add_column(heading, justify="left" if heading == "engine" else "right", no_wrap=True)
        for number, push in enumerate(self.pushes):
            for engine, course in push.courses.items():
                cells = [""] * 5
                if (apart := push.differences.get(engine)) is not None:
                    cells = [*_pair(apart.translation, apart.rotation)]
                    cells += [*_pair(apart.path_translation, apart.path_rotation), f"{100 * apart.same_modes:.0f}"]
                contact = [" ".join(f"{100 * share:.0f}" for share in pair) for pair in (course.floor, course.pusher)]
                own = _pair(course.moved, course.turned)
                name = str(number) if engine == TWIN else ""
                table.add_row(name, engine, *own, *cells, *contact, f"{1e3 * course.energy_stop:.2f}")
            table.add_section()
        return table

    def words(self) -> list[str]:
        """Remarks on parameters that plants do not take over, and on motions that failed, did not end or gained energy.

        There is one line for each parameter, and one for each push and engine.
        """
        return [effect.words() for effect in self.effects] + [
            f"push {number}, {engine}: {course.words()}"
            for number, push in enumerate(self.pushes)
            for engine, course in push.courses.items()
            if course.words()
        ]

    def results(self) -> list[tuple[bool, str]]:
        """Verdict on each engine: whether the twin agrees, and a line about it."""
        return [(verdict.passed, verdict.words(self.options)) for verdict in self.verdicts]

    def write(self, out: str | Path, setup: Setup, title: str) -> list[Path]:
        """Write the table, with a row for each push and engine, and a figure.

        The table has SI units, radians and the world frame; shares of time are 0 to 1.

        Args:
            out: Folder of the files; made if need be.
            setup: The scene of the twin.
            title: Title of the figure; what plants do not take over follows it.

        Raises:
            InputError: A file cannot be written.
        """
        out = prepare_folder(Path(out))
        table, figure = out / TABLE_FILE, out / FIGURE_FILE
        with replacing(table) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow(COLUMNS)
            for number, push in enumerate(self.pushes):
                writer.writerows(_rows(number, push))
        worst, options = self.worst(), self.options
        motions = self.pushes[worst].motions
        crosscheck_figure(
            figure,
            [
                Differences(
                    verdict.engine,
                    [one.differences[verdict.engine].translation for one in self.pushes],
                    [one.differences[verdict.engine].rotation for one in self.pushes],
                    verdict.passed,
                )
                for verdict in self.verdicts
            ],
            thresholds=options.limits,
            mesh=load_mesh(setup.twin.mesh_path),
            worst=worst,
            paths={name: (motion.p_WO, motion.q_WO) for name, motion in motions.items()},
            p_WP=motions[TWIN].p_WP,
            title="\n".join([title, *(effect.words() for effect in self.effects)]),
        )
        return [table, figure]

    def worst(self) -> int:
        """Index of the push with the largest difference after rest, in units of the thresholds."""
        limits = self.options.limits
        scores = [
            max(max(d.translation / limits[0], d.rotation / limits[1]) for d in push.differences.values())
            for push in self.pushes
        ]
        return int(np.argmax(scores))


def judge_pushes(
    options: CrossCheckOptions, cases: Cases, trials: Sequence[Trial], motions: Sequence[dict[str, Motion]]
) -> PushCheck:
    """Compare the motions of an object that is pushed in the twin and in plants; arguments as for `run_trials`."""
    weights = {name: one.twin.theta["mass"].value * one.twin.gravity for name, one in cases.items()}
    shown = [name for name in cases if name in (TWIN, *options.engines, *map(like, options.engines))]
    results = [
        PushComparison(
            trial,
            {name: found[name] for name in shown},
            {name: course_of(found[name], weights[name]) for name in shown},
            {name: difference_of(found[alike(name, found)], found[name]) for name in options.engines},
        )
        for trial, found in zip(trials, motions, strict=True)
    ]
    verdicts = [_judge(name, results, options) for name in options.engines]
    return PushCheck(options, results, verdicts, effects(cases[TWIN], options.engines, motions))


def _judge(engine: str, results: list[PushComparison], options: CrossCheckOptions) -> Verdict:
    translation = np.array([result.differences[engine].translation for result in results])
    rotation = np.array([result.differences[engine].rotation for result in results])
    pairs = [(result.courses[alike(engine, result.courses)], result.courses[engine]) for result in results]
    medians = median(translation), median(rotation)
    return Verdict(
        engine=engine,
        median_translation=medians[0],
        median_rotation=medians[1],
        most_translation=float(translation.max()),
        most_rotation=float(rotation.max()),
        unsound=sum(not (a.sound and b.sound) for a, b in pairs),
        rising=sum(a.energy_rises or b.energy_rises for a, b in pairs),
        passed=medians[0] <= options.limits[0] and medians[1] <= options.limits[1],
    )


def _rows(number: int, result: PushComparison) -> Iterator[list[str]]:
    X_WO, push = result.trial.X_WO, result.trial.push
    place = [*X_WO.translation(), *X_WO.rotation().ToQuaternion().wxyz(), *push.p_WP, *push.direction_W[:2]]
    start = [str(number), *_numbers([*place, push.speed, push.distance])]
    for engine, course in result.courses.items():
        apart = [""] * len(_DIFFERENCE)
        if engine in result.differences:
            apart = _numbers(astuple(result.differences[engine]))
        energies = [course.energy_peak, course.energy_stop, course.energy_rise]
        own = _numbers([course.moved, course.turned, course.rest_time, *energies, *course.floor, *course.pusher])
        yield [*start, engine, *apart, *own, course.failure]


def _numbers(values: Sequence[float]) -> list[str]:
    return [f"{value:.9g}" for value in values]


def _pair(translation: float, rotation: float) -> tuple[str, str]:
    return f"{1e3 * translation:.1f}", f"{math.degrees(rotation):.1f}"
