# SPDX-License-Identifier: MIT
"""Recipe of the flip task: PPO from waypoints, a planner that samples, captures and cross-checks of pokes."""

import math
from typing import Any

import numpy as np

from pinwm_drake.tasks.flip import LENGTH, FlipTask, tilt
from pinwm_drake.tasks.recipe import Recipe


def _assembly(task: FlipTask, low: np.ndarray, high: np.ndarray) -> Any:
    from pinwm_drake.tasks.flip_assembly import FlipAssembly

    return FlipAssembly(task.origin, LENGTH, low, high, round=not any(task.side))


FLIP = Recipe(
    scene="flip_mug",
    algorithm="ppo",
    training_step=1 / 480,  # at 1.25 m/s the pusher moves 2.6 mm
    heading=15,
    level_vectors=(0, 3, 6, 9, 12, 15),
    disturbance=0.03,  # velocities after an action differ from those of MuJoCo by 2 to 5 % (median)
    continued=0.25,  # a stroke that missed leaves object and pusher where no start has them
    retries=0.25,  # of the four in ten that do not begin at a waypoint
    spread=(1.0, 1.8),  # engines press at the ends of a line, or evenly; real faces where they are high
    most_force=50.0,  # of an arm of a few kg; strokes that turn the mug over have 1 to 6
    light=0.6,  # lamps of a room, and of other renderers
    # Where the strokes of docs/results/policies.md turn a mug over, of frictions of 0.05 to 0.5 and 0.3 to 1.2.
    possible={"friction_floor": (0.1, 0.5), "friction_pusher": (0.3, 1.2)},
    image_size=256,  # a pixel is 1.7 mm of the mug in the scene's middle
    history=2,
    latency=(0.0, 0.12),
    assembly=_assembly,
    waypoints=True,  # chance hardly ever turns an object over
    motion="poke",
    check="pokes",
    success_words=lambda task: f"success is rest on the floor within {task.turn_tolerance:g} rad of upright",
    estimate_words=lambda task, state: f"{math.degrees(tilt(state)):.0f} deg from upright",
)
