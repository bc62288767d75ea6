"""The same pushes through the learned twin and through Drake's own contact models."""

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
from pinwm_drake.systems.crosscheck.motion import Motion, PushRig
from pinwm_drake.systems.crosscheck.trials import Trial, draw_trials
from pinwm_drake.systems.pusher.choice import SPEEDS
from pinwm_drake.systems.scenario.schema import ENGINES
from pinwm_drake.systems.scenario.setup import Setup

PLANTS = tuple(name for name in ENGINES if name != "twin")
_MOST_PUSHES, _MOST_PROCESSES = 10_000, 64
# What an engine is called, and the setup of its station.
Cases = dict[str, Setup]
_rigs: dict[str, dict[str, PushRig]] = {}  # of a process: those of the last call, by its name and the engine


@dataclass(frozen=True)
class CrossCheckOptions:
    """What is compared with what, and what is agreement.

    Attributes:
        engines: Drake's contact models, each compared with the twin.
        pushes: How many.
        seed: Of the pushes.
        threshold_translation: m, for the median over the pushes of the difference after rest.
        threshold_rotation: rad, likewise.
        processes: That share the pushes.

    Raises:
        ParameterError: One is out of range.
    """

    engines: tuple[str, ...] = PLANTS
    pushes: int = 20
    seed: int = 0
    threshold_translation: float = 3e-3
    threshold_rotation: float = math.radians(2.0)
    processes: int = 1

    def __post_init__(self) -> None:
        """Checks the numbers."""
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
        motions: By engine; the twin's too.
        courses: The same, summed up.
        differences: By engine, from the twin.
    """

    trial: Trial
    motions: dict[str, Motion]
    courses: dict[str, Course]
    differences: dict[str, Difference]


@dataclass(frozen=True)
class Verdict:
    """On an engine. It passes where both medians keep their thresholds.

    Attributes:
        engine: Which.
        median_translation: m, of the differences after rest.
        median_rotation: rad.
        most_translation: m.
        most_rotation: rad.
        unsound: How many pushes did not come to an end in the twin or in this engine; their difference is infinite.
        rising: In how many energy came from nowhere, in the twin or in this engine.
        passed: Whether the twin agrees with it.
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
    """What came of a cross-check.

    Attributes:
        options: What was compared.
        pushes: The results, in the order of the draw.
        verdicts: One for each engine.
    """

    options: CrossCheckOptions
    pushes: list[PushResult]
    verdicts: list[Verdict]

    @property
    def passed(self) -> bool:
        """Whether the twin agrees with every engine."""
        return all(verdict.passed for verdict in self.verdicts)

    def worst(self) -> int:
        """The push with the largest difference, against the thresholds."""
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
    """Pushes the object in the twin and in plants, from the same states, and compares.

    Args:
        setup: The twin. Limits of its pusher, and the number of its worlds, do not count.
        options: What is compared.
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
    """The same with one world, and a pusher that may go wherever it is told."""
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
    """The middle one, or the mean of the two; infinite rather than undefined where those are infinite."""
    with np.errstate(invalid="ignore"):
        middle = float(np.median(values))
    return math.inf if math.isnan(middle) else middle


def run_trials(
    cases: Cases, trials: Sequence[Trial], *, processes: int = 1, report: Callable[[], None] = lambda: None
) -> list[dict[str, Motion]]:
    """Every push through every engine.

    Args:
        cases: The engines.
        trials: The pushes.
        processes: That share the pushes, 1 or more; with one thread each. Results do not depend on it.
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
        _rigs[name] = {engine: PushRig(setup, engine) for engine, setup in cases.items()}
    return {engine: rig.run(trial) for engine, rig in _rigs[name].items()}
