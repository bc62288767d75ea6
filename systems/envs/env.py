# SPDX-License-Identifier: MIT
"""A task as a gymnasium environment over a station of any engine."""

import dataclasses
from typing import Any, Literal

import gymnasium
import numpy as np

from pinwm_drake.errors import require
from pinwm_drake.systems.envs.observation import Observation
from pinwm_drake.systems.envs.options import EnvOptions
from pinwm_drake.systems.envs.picture import TaskPicture
from pinwm_drake.systems.envs.worlds import Worlds, progress_info
from pinwm_drake.systems.scenario.load import Scene
from pinwm_drake.systems.scenario.schema import ENGINES


class TaskEnv(gymnasium.Env[Observation, np.ndarray]):
    """Environment of one world, in which a task is to be done.

    An action in [-1, 1]^n is a translation of the pusher along the task's n axes in units of `max_translation`, no
    longer than one such, over the scenario's `pusher.horizon` (0.1 s). Observations: `Observer`; rewards and success:
    `Task`. An episode terminates with success, and is truncated after `max_steps`, or when the physics finds no
    solution (`info["failure"]` says why).

    `info`: `distance` [m], `angle` [rad], `success`, `step` and `engine`; after a failure also `failure`.

    Args:
        scene: A setup, a scenario, the name or path of one, or the folder of a twin; see `load_setup`.
        engine: "twin", "hydroelastic" or "point"; None for that of the scenario.
        options: Options of the environment; None for the defaults.
        render_mode: "rgb_array" for pictures by `render`, or None.
        changes: Single fields of `EnvOptions`, in the place of those of `options`.

    Attributes:
        worlds: `Worlds` of one world.
        setup, task, run, max_steps: Those of the worlds.

    Raises:
        InputError: The scene, or one of its files, cannot be used.
        ParameterError: An option is none of those allowed.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 10}  # noqa: RUF012  # as gymnasium has it

    def __init__(
        self,
        scene: Scene = "push_t",
        engine: str | None = None,
        options: EnvOptions | None = None,
        *,
        render_mode: Literal["rgb_array"] | None = None,
        **changes: Any,
    ) -> None:
        require("render_mode", repr(render_mode), render_mode in (None, "rgb_array"), "rgb_array, or None")
        require("engine", repr(engine), engine is None or engine in ENGINES, ", ".join(ENGINES))
        self.worlds = Worlds(scene, engine, 1, changed_options(options, changes))
        self.setup, self.task, self.run = self.worlds.setup, self.worlds.task, self.worlds.run
        self.engine, self.max_steps = self.worlds.engine, self.worlds.max_steps
        self._picture: TaskPicture | None = None
        self.render_mode = render_mode
        self.observation_space = self.worlds.observation_space
        self.action_space = self.worlds.action_space

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begins an episode.

        Args:
            seed: Seed of this episode and those that follow; None goes on with the last one's generator.
            options: Options of the world as for `Worlds.reset`, instead of what is drawn.

        Raises:
            ParameterError: There is no such option.
        """
        super().reset(seed=seed)
        self.worlds.set_generator(0, self.np_random)
        observation = self.worlds.reset(options=None if options is None else [options])
        info = progress_info(self.worlds.progress, 0) | {"step": 0, "engine": self.engine}
        return row_of(observation, 0), info

    def step(self, action: np.ndarray) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Goes on by one action (n,) in [-1, 1]^n."""
        out = self.worlds.advance(np.asarray(action)[None])
        observation = row_of(self.worlds.observe(), 0)
        reward, terminated, truncated = float(out.reward[0]), bool(out.terminated[0]), bool(out.truncated[0])
        return observation, reward, terminated, truncated, out.info(0, self.engine)

    def render(self) -> np.ndarray | None:
        """Picture (f height, f width, 3) uint8 RGB of camera, goal and pusher; None without a render mode.

        The whole factor f is that of `TaskPicture.draw`.
        """
        if self.render_mode is None:
            return None
        self._picture = self._picture or TaskPicture(self.setup)
        return self._picture.draw(self.run.images()[0], self.run.p_WP[0])


def changed_options(options: EnvOptions | None, changes: dict[str, Any]) -> EnvOptions:
    """Options with single fields changed.

    Raises:
        ParameterError: There is no such option, or a value is out of range.
    """
    known = [field.name for field in dataclasses.fields(EnvOptions)]
    for name in changes:
        require("options", repr(name), name in known, ", ".join(known))
    return dataclasses.replace(options or EnvOptions(), **changes)


def row_of(observation: Observation, row: int) -> Observation:
    """Part of one world in an observation of several."""
    if isinstance(observation, dict):
        return {name: values[row] for name, values in observation.items()}
    return observation[row]
