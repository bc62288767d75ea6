"""Comparison of a twin with Drake's own contact models, by the motions that the recipe of its task names."""

from collections.abc import Callable

from pinwm_drake.systems.crosscheck.options import CrossCheckOptions
from pinwm_drake.systems.crosscheck.pokes import PokeCheck, poke_check
from pinwm_drake.systems.crosscheck.pushes import PushCheck, push_check
from pinwm_drake.systems.scenario.setup import Setup
from pinwm_drake.tasks.registry import recipe_of

CHECKS: dict[str, Callable[..., PushCheck | PokeCheck]] = {"pushes": push_check, "pokes": poke_check}


def cross_check(
    setup: Setup,
    options: CrossCheckOptions,
    *,
    truth: dict[str, float] | None = None,
    report: Callable[[], None] = lambda: None,
) -> PushCheck | PokeCheck:
    """Compares the motions of a scene's object in the twin and in plants, from the same states.

    Args:
        setup: The scene of the twin, whose task's recipe names the motions.
        options: Engines, number of motions and thresholds.
        truth: Values of `THETA`'s parameters that the plants have instead of the twin's; None compares the physics at
            equal theta, the truth checks the theta too.
        report: Called after each motion.

    Raises:
        ParameterError: The pusher cannot meet a side of the object, or the truth names an unknown parameter.
        InputError: A mesh cannot be used.
    """
    return CHECKS[recipe_of(setup.task).check](setup, options, truth=truth, report=report)
