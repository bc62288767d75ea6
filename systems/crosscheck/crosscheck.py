# SPDX-License-Identifier: MIT
"""Comparison of a twin with Drake's own contact models, by the motions that the recipe of its task names.

A plant has the twin's parameters. Where it cannot have one, it is compared with the twin without it, and the effect of
the parameter is told.
"""

from collections.abc import Callable
from typing import Any

from pinwm_drake.systems.crosscheck.alike import TWIN, extra_cases
from pinwm_drake.systems.crosscheck.motion import run_trials, unlimited
from pinwm_drake.systems.crosscheck.options import CrossCheckOptions
from pinwm_drake.systems.crosscheck.pokes import PokeCheck, draw_pokes, judge_pokes
from pinwm_drake.systems.crosscheck.pushes import PushCheck, judge_pushes
from pinwm_drake.systems.crosscheck.trials import draw_trials
from pinwm_drake.systems.scenario.load import Scene, load_setup
from pinwm_drake.tasks.registry import recipe_of

# How motions are drawn and judged, by the name that a recipe gives them.
CHECKS: dict[str, tuple[Callable[..., Any], Callable[..., PushCheck | PokeCheck]]] = {
    "pushes": (draw_trials, judge_pushes),
    "pokes": (
        lambda setup, reference, number, seed: draw_pokes(setup, number, seed),
        judge_pokes,
    ),
}


def crosscheck(
    scene: Scene,
    options: CrossCheckOptions,
    *,
    truth: dict[str, float] | None = None,
    report: Callable[[], None] = lambda: None,
) -> PushCheck | PokeCheck:
    """Compare the motions of a scene's object in the twin and in plants, from the same states.

    Args:
        scene: The scene of the twin, see `load_setup`, whose task's recipe names the motions. Limits of its pusher, and
            the number of its worlds, do not count.
        options: Engines, number of motions and thresholds.
        truth: Values of `THETA`'s parameters that the plants have instead of the twin's; None compares the physics at
            equal theta, the truth checks the theta too. All else is the twin's: a plant has its centre of mass, its
            spread of the pressure and its contact offset, or is compared with the twin without them, see `alike.py`.
        report: Called after each motion.

    Raises:
        ParameterError: The pusher cannot meet a side of the object, no poke tips it, or the truth names an unknown
            parameter.
        InputError: A mesh cannot be used.
    """
    setup = load_setup(scene)
    draw, compare = CHECKS[recipe_of(setup.task).check]
    setup = unlimited(setup)
    reference = setup.with_theta(**(truth or {}))
    trials = draw(setup, reference, options.pushes, options.seed)
    cases = {TWIN: setup, **dict.fromkeys(options.engines, reference), **extra_cases(setup, options.engines)}
    return compare(options, cases, trials, run_trials(cases, trials, processes=options.processes, report=report))
