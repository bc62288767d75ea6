# SPDX-License-Identifier: MIT
"""Recipe of the push task: SAC, a planner of planar pushes, captures and cross-checks of level pushes."""

import math
from typing import Any

import numpy as np

from pinwm_drake.tasks.push import LENGTH, PushTask, offset_from_goal
from pinwm_drake.tasks.recipe import Recipe


def _success_words(task: PushTask) -> str:
    return f"success is rest within {1e3 * task.tolerance:g} mm and {task.turn_tolerance:g} rad of the goal"


def _estimate_words(task: PushTask, state: np.ndarray) -> str:
    distance, turn = offset_from_goal(state)
    return f"{1e3 * distance:.0f} mm, {math.degrees(turn):.1f} deg from the goal"


def _assembly(task: PushTask, low: np.ndarray, high: np.ndarray) -> Any:
    from pinwm_drake.tasks.push_assembly import PushAssembly

    return PushAssembly(np.array(task.goal), LENGTH, low, high)


PUSH = Recipe(
    max_translation=0.02,
    training_step=1 / 120,  # twelve steps an action: tenths of a millimetre do not count
    assembly=_assembly,
    planner="outline",
    success_words=_success_words,
    estimate_words=_estimate_words,
)
