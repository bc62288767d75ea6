# SPDX-License-Identifier: MIT
"""The recipe beside a task: how it is learned, planned, filmed, checked and displayed.

What stands in higher layers is named by plain words, which these layers look up: no one asks which task it is.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np


@dataclass(frozen=True)
class Recipe:
    """Recipe of a task; the defaults do for any task.

    Attributes:
        scene: Name of a scenario that ships, in which the task is done where none is named.
        algorithm: Algorithm that a teacher of the state learns with.
        max_translation: m, longest translation in an action that policies are trained for and controllers are tried
            with; None for the longest that the pusher's speed allows.
        training_step: s, step of the physics that policies are trained in; None for that of the scene.
        heading: Index in the state of the x of the pusher from the object, whose y follows, where the task is the same
            at any yaw: policies see and act along that way. None where directions of the world matter.
        level_vectors: Indices in the state of the x of each vector, whose y follows, where there is a heading.
        disturbance: Standard deviation of what training adds to the object's velocities after each action, in shares of
            them: as far as engines differ, where little things have other outcomes.
        continued: Share of the episodes of a training that begin where the one before met its time limit.
        retries: Share of the other episodes of a training that begin as after a try that failed: the object lies, the
            pusher is on any side of it or over it.
        spread: Least and largest spread of the pressure on a face or line of the object, drawn by each episode of a
            training: 1 is even, and ends alone carry at 1.7 to 1.9. None for that of the scene.
        most_force: N, largest mean force of the pusher in an action, for policies in training and for planners: an
            episode with more has failed. None without a limit. A pusher that pinches an object against the floor stops
            a robot, and has other outcomes in each engine.
        light: Largest share of its colour that the darkest side of the object loses in the light of an episode of
            training; the whole object loses up to as much once more.
        possible: Ranges of theta, by name, in which plans of this task have done it; empty where all was tried.
        image_size: px, size of the images of policies with a history; those without have the default.
        history: Number of the last actions that policies see; 0 where PPO learns from images.
        latency: s, least and largest delay of an action that policies are trained for; with a station, its own counts.
        assembly: Function of the task and of the corners `low` and `high`, each (action_size,) m, world, of the
            pusher's box along the task's axes, where its observation is -1 and 1. It gives a torch module from a
            network's estimate (B, n) and the pusher (B, action_size) to the state (B, state_size), or None where the
            estimate is the state itself. The module has `estimate_size`, n, which may be less than `state_size`, as
            the pusher is known. Its third argument is a place (B, 2) m on the floor from which the estimated one of
            the object counts, or None; the fourth, of tasks with a `goal_size`, the episodes' goals (B, goal_size), or
            None for the task's own.
        waypoints: Flag: most episodes of a training begin in states of plans, as chance hardly ever succeeds.
        planner: Planner of the model-predictive controller: "outline" pushes at the object's planar outline,
            "sampling" tries sequences of actions in the twin's worlds.
        motion: Motion that a simulated capture films: level pushes, or pokes that rock the object.
        check: Motions by which a twin of this task is compared with Drake's plants.
        success_words: Function of the task: its criterion of success in words, for reports.
        estimate_words: Function of the task and a state (state_size,): the state's distance from the goal in words, for
            displays; empty where there are none.
    """

    scene: str = "push_t"
    algorithm: Literal["sac", "ppo"] = "sac"
    max_translation: float | None = None
    training_step: float | None = None
    heading: int | None = None
    level_vectors: tuple[int, ...] = ()
    disturbance: float = 0.0
    continued: float = 0.0
    retries: float = 0.0
    spread: tuple[float, float] | None = None
    most_force: float | None = None
    light: float = 0.0
    possible: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    image_size: int = 64
    history: int = 0
    latency: tuple[float, float] = (0.0, 0.0)
    assembly: Callable[[Any, np.ndarray, np.ndarray], Any] = lambda task, low, high: None
    waypoints: bool = False
    planner: Literal["outline", "sampling"] = "sampling"
    motion: Literal["push", "poke"] = "push"
    check: Literal["pushes", "pokes"] = "pushes"
    success_words: Callable[[Any], str] = lambda task: f"success in the task {task.name}"
    estimate_words: Callable[[Any, np.ndarray], str] = lambda task, state: ""

    def doubts(self, ranges: Mapping[str, tuple[float, float]]) -> list[str]:
        """Sentences on what is beyond `possible`, of ranges of theta by name."""
        found = []
        for name, (low, high) in self.possible.items():
            least, most = ranges.get(name, (low, high))
            if least < low or most > high:
                given = f"{least:.2g}" if least == most else f"{least:.2g} to {most:.2g}"
                found.append(f"{name} is {given}; {self.scene} is known to be possible from {low:g} to {high:g}")
        return found
