# SPDX-License-Identifier: MIT
"""Options of environments, and the setup of a scene whose state is updated once an action."""

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from pinwm_drake.errors import ParameterError, require
from pinwm_drake.rendering.camera import Camera
from pinwm_drake.systems.envs.observation import Kind
from pinwm_drake.systems.sampling import whole_multiple
from pinwm_drake.systems.scenario.setup import Setup, placed_task
from pinwm_drake.tasks.registry import changed_task
from pinwm_drake.tasks.task import Task

_ROUNDING = 1e-9  # relative, by which a translation may exceed the allowed one


@dataclass(frozen=True)
class EnvOptions:
    """Options that environments of one world and of many share; the defaults are those of the scene and its task.

    Attributes:
        observation: "state", "rgb", or "rgb_state" for both.
        frames: Number of the last images that are seen, 1 or more.
        task: A task; or fields of the scene's task that are to be others, such as {"reward": "shaped"}; or None.
        max_steps: Number of actions after which an episode is truncated; None for the task's.
        max_translation: m, longest translation of the pusher in an action; None for the longest that its speed allows.
        time_step: s, step of the twin's physics; None for that of the scene. It divides the horizon of an action.
        image_size: px, width and height of images; None for those of the scene's camera.
        latency: s, least and largest time after which an action takes effect; drawn for each episode. See `Delay`.
        lag: s, least and largest time constant with which the pusher's velocity follows; drawn for each episode.
        acceleration: m/s^2, largest one of the pusher; infinite for none.
        history: Number of the last actions that are seen, with the states before them; see `Observer`.
        view: (3,) m, world, by which images show the object beside where it is, as a twin's `view_x` to `view_z` tell
            of a camera that was calibrated wrongly; in the twin's worlds alone.

    Raises:
        ParameterError: `max_steps` is less than 1, `history` less than 0, `acceleration` 0 or less, or a number of
            `view` not finite.
    """

    observation: Kind = "state"
    frames: int = 1
    task: Task | Mapping[str, Any] | None = None
    max_steps: int | None = None
    max_translation: float | None = None
    time_step: float | None = None
    image_size: int | None = None
    latency: tuple[float, float] = (0.0, 0.0)
    lag: tuple[float, float] = (0.0, 0.0)
    acceleration: float = math.inf
    history: int = 0
    view: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        require("max_steps", self.max_steps, self.max_steps is None or self.max_steps >= 1, "1 or more")
        require("history", self.history, self.history >= 0, "0 or more")
        require("acceleration", self.acceleration, self.acceleration > 0.0, "more than 0")
        if len(self.view) != 3 or not np.isfinite(self.view).all():
            raise ParameterError(f"view: got {self.view}; allowed: three finite numbers")

    def task_in(self, setup: Setup) -> Task:
        """Return the task in a scene, with the object's orientation of that scene.

        Raises:
            ParameterError: There is no such task or field, or a value is out of range.
        """
        return placed_task(changed_task(setup.task, self.task), setup.scenario, setup.twin)


def environment_setup(setup: Setup, options: EnvOptions | None = None, *, num_worlds: int = 1) -> Setup:
    """Make the setup of an environment.

    The velocity of the pusher is constant in an action, so that state and sample are taken once an action, whatever
    the scenario says: the steps of the physics are the same, and the diagram is run less often.

    Args:
        setup: The scene.
        options: Task, physics and image size; None for those of the scene.
        num_worlds: Number of worlds, 1 or more.

    Raises:
        ParameterError: The horizon is no whole multiple of a time step, or there is no such task, or a value of it is
            out of range.
    """
    options = options or EnvOptions()
    scenario, twin, camera, view = setup.scenario, setup.twin, setup.camera, setup.scenario.camera
    given: dict[str, Any] = {} if options.time_step is None else {"time_step": options.time_step}
    twin = dataclasses.replace(twin, **given)
    if options.image_size is not None:
        view = dataclasses.replace(view, width=options.image_size, height=options.image_size)
        camera = Camera.from_field_of_view(options.image_size, options.image_size, view.fov_y)
    steps = whole_multiple("pusher.horizon", scenario.pusher.horizon, twin.time_step, "the time step")
    physics = dataclasses.replace(scenario.physics, steps_per_update=steps, **given)
    pusher = dataclasses.replace(scenario.pusher, period=None)
    scenario = dataclasses.replace(scenario, num_worlds=num_worlds, physics=physics, pusher=pusher, camera=view)
    period = twin.time_step * steps
    whole_multiple("pusher.horizon", period, setup.plant_time_step, "plant.time_step")
    task = options.task_in(setup)
    return dataclasses.replace(setup, scenario=scenario, twin=twin, camera=camera, period=period, task=task)


def longest_translation(setup: Setup, wanted: float | None) -> float:
    """Longest translation of the pusher in an action, m.

    Args:
        setup: The scene.
        wanted: m, the translation to allow; None for the longest that the pusher's speed allows.

    Raises:
        ParameterError: It is not positive, or longer than the pusher's speed allows.
    """
    pusher = setup.scenario.pusher
    longest = pusher.horizon * pusher.max_speed
    if wanted is None:
        return longest
    if not 0 < wanted <= longest * (1 + _ROUNDING):
        allowed = f"more than 0, at most {longest:g} m, as horizon and max_speed of the pusher say"
        raise ParameterError(f"max_translation: got {wanted} m; allowed: {allowed}")
    return float(wanted)
