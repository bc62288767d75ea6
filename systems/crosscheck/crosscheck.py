"""Comparison of the learned twin with Drake's own contact models, by equal pushes."""

import dataclasses
import math
import uuid
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from pinwm_drake.errors import ParameterError, require
from pinwm_drake.parallel import Executor
from pinwm_drake.systems.crosscheck.difference import Course, Difference, course_of, difference_of
from pinwm_drake.systems.crosscheck.motion import Motion, SceneRig
from pinwm_drake.systems.crosscheck.trials import Trial, draw_trials
from pinwm_drake.systems.pusher.choice import SPEEDS
from pinwm_drake.systems.scenario.schema import ENGINES
from pinwm_drake.systems.scenario.setup import Setup

PLANTS = tuple(name for name in ENGINES if name != "twin")
_MOST_PUSHES, _MOST_PROCESSES = 10_000, 64
# Setups of stations, by the engine's name.
Cases = dict[str, Setup]
_rigs: dict[str, dict[str, SceneRig]] = {}  # of a process: those of the last call, by its name and the engine


@dataclass(frozen=True)
class CrossCheckOptions:
    """Options of a cross-check: engines, pushes, and thresholds of agreement.

    Attributes:
        engines: Drake's contact models, each compared with the twin.
        pushes: Number of pushes.
        seed: Seed of the pushes.
        threshold_translation: m, largest median over the pushes of the difference after rest.
        threshold_rotation: rad, likewise.
        processes: Number of processes that share the pushes.

    Raises:
        ParameterError: An option is out of range.
    """

    engines: tuple[str, ...] = PLANTS
    pushes: int = 20
    seed: int = 0
    threshold_translation: float = 3e-3
    threshold_rotation: float = math.radians(2.0)
    processes: int = 1

    def __post_init__(self) -> None:
        """Checks names and numbers."""
        for name in self.engines:
            if name not in PLANTS:
                raise ParameterError(f"engine: got {name!r}; allowed: {', '.join(PLANTS)}")
        if not self.engines or len(set(self.engines)) != len(self.engines):
            raise ParameterError(f"engines: got {', '.join(self.engines) or 'none'}; allowed: one or more, each once")
        require("pushes", self.pushes, 1 <= self.pushes <= _MOST_PUSHES, f"1 to {_MOST_PUSHES}")
        require("seed", self.seed, 0 <= self.seed < 2**63, "0 or more")
        require("processes", self.processes, 1 <= self.processes <= _MOST_PROCESSES, f"1 to {_MOST_PROCESSES}")
        translation, rotation = self.threshold_translation, self.threshold_rotation
        require("threshold of translation", translation, 0 < translation <= 1, "more than 0, up to 1 m")
        require("threshold of rotation", rotation, 0 < rotation <= math.pi, "more than 0, up to pi rad")


@dataclass(frozen=True, eq=False)
class PushResult:
    """A push in all engines.

    Attributes:
        trial: The push.
        motions: Motion by the engine's name; the twin's too.
        courses: Summary of each motion, by the engine's name.
        differences: Difference from the twin, by the engine's name.
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


@dataclass(frozen=True, eq=False)
class CrossCheck:
    """Results of a cross-check.

    Attributes:
        options: Options of the cross-check.
        pushes: Results of the pushes, in the order of the draw.
        verdicts: Verdict on each engine.
    """

    options: CrossCheckOptions
    pushes: list[PushResult]
    verdicts: list[Verdict]

    @property
    def passed(self) -> bool:
        """Flag: the twin agrees with every engine."""
        return all(verdict.passed for verdict in self.verdicts)

    def worst(self) -> int:
        """Index of the push with the largest difference after rest, in units of the thresholds."""
        limits = self.options.threshold_translation, self.options.threshold_rotation
        scores = [
            max(max(d.translation / limits[0], d.rotation / limits[1]) for d in push.differences.values())
            for push in self.pushes
        ]
        return int(np.argmax(scores))


def cross_check(
    setup: Setup,
    options: CrossCheckOptions,
    *,
    truth: dict[str, float] | None = None,
    report: Callable[[], None] = lambda: None,
) -> CrossCheck:
    """Compares the motions of an object that is pushed in the twin and in plants, from the same states.

    Args:
        setup: The scene of the twin. Limits of its pusher, and the number of its worlds, do not count.
        options: Engines, pushes and thresholds.
        truth: Values of `THETA`'s parameters that the plants have instead of the twin's; None compares the physics at
            equal theta, the truth checks the theta too.
        report: Called after each push.

    Returns:
        The comparison.

    Raises:
        ParameterError: The pusher cannot meet a side of the object, or the truth names an unknown parameter.
        InputError: A mesh cannot be used.
    """
    setup = unlimited(setup)
    reference = setup.with_theta(**(truth or {}))
    trials = draw_trials(setup, reference, options.pushes, options.seed)
    cases = {"twin": setup, **dict.fromkeys(options.engines, reference)}
    motions = run_trials(cases, trials, processes=options.processes, report=report)
    weights = {name: one.twin.theta["mass"].value * one.twin.gravity for name, one in cases.items()}
    results = [
        PushResult(
            trial,
            found,
            {name: course_of(motion, weights[name]) for name, motion in found.items()},
            {name: difference_of(found["twin"], found[name]) for name in options.engines},
        )
        for trial, found in zip(trials, motions, strict=True)
    ]
    return CrossCheck(options, results, [_judge(name, results, options) for name in options.engines])


def unlimited(setup: Setup) -> Setup:
    """The setup with one world, and a pusher that may go wherever it is told."""
    far = 1e2
    pusher = dataclasses.replace(
        setup.scenario.pusher, max_speed=4 * SPEEDS[1], low=[-far, -far, -far], high=[far, far, far]
    )
    return dataclasses.replace(setup, scenario=dataclasses.replace(setup.scenario, num_worlds=1, pusher=pusher))


def _judge(engine: str, results: list[PushResult], options: CrossCheckOptions) -> Verdict:
    translation = np.array([result.differences[engine].translation for result in results])
    rotation = np.array([result.differences[engine].rotation for result in results])
    pairs = [(result.courses["twin"], result.courses[engine]) for result in results]
    medians = _median(translation), _median(rotation)
    return Verdict(
        engine=engine,
        median_translation=medians[0],
        median_rotation=medians[1],
        most_translation=float(translation.max()),
        most_rotation=float(rotation.max()),
        unsound=sum(not (a.sound and b.sound) for a, b in pairs),
        rising=sum(a.energy_rises or b.energy_rises for a, b in pairs),
        passed=medians[0] <= options.threshold_translation and medians[1] <= options.threshold_rotation,
    )


def _median(values: np.ndarray) -> float:
    """Median of values (n,); infinite rather than undefined where the two in the middle are infinite."""
    with np.errstate(invalid="ignore"):
        middle = float(np.median(values))
    return math.inf if math.isnan(middle) else middle


def run_trials(
    cases: Cases, trials: Sequence[Trial], *, processes: int = 1, report: Callable[[], None] = lambda: None
) -> list[dict[str, Motion]]:
    """Runs every push in every engine.

    Args:
        cases: Setups by the engine's name.
        trials: The pushes.
        processes: Number of processes that share the pushes, 1 or more; with one thread each. Results do not depend on
            it.
        report: Called after each push.

    Returns:
        For each push the motion in each engine, in the order of the trials.

    Raises:
        PinwmError: A station cannot be made.
    """
    # Cases cannot be compared, so that each call has a name of its own.
    run = partial(_run, uuid.uuid4().hex, cases)
    try:
        return Executor(workers=processes, option="--processes").map(run, trials, on_result=lambda *_: report())
    finally:
        _rigs.clear()


def _run(name: str, cases: Cases, trial: Trial) -> dict[str, Motion]:
    """A push through every engine, whose stations are made for the first one and kept."""
    if name not in _rigs:
        _rigs.clear()
        _rigs[name] = {engine: SceneRig(setup, engine) for engine, setup in cases.items()}
    return {engine: rig.run(trial) for engine, rig in _rigs[name].items()}
