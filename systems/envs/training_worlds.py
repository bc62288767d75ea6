# SPDX-License-Identifier: MIT
"""The worlds that a policy is trained in: domains around a twin, or the twin alone."""

import dataclasses
import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from stable_baselines3.common.vec_env import VecEnv

from pinwm_drake.checkpoints import generator_state, set_generator_state
from pinwm_drake.cousins.cousin import Cousin
from pinwm_drake.cousins.domain import CousinDomains, DomainDraw, DomainSource
from pinwm_drake.errors import require
from pinwm_drake.learning.spec import Observes, PolicySpec
from pinwm_drake.learning.worlds import TowardGoal
from pinwm_drake.systems.envs.env import changed_options
from pinwm_drake.systems.envs.observation import Kind
from pinwm_drake.systems.envs.options import EnvOptions, environment_setup
from pinwm_drake.systems.envs.policy_scene import policy_spec
from pinwm_drake.systems.envs.vector import TaskVecEnv
from pinwm_drake.systems.scenario.load import Scene, load_setup, scene_hash
from pinwm_drake.systems.scenario.start import with_start_yaw
from pinwm_drake.tasks.registry import recipe_of
from pinwm_drake.tasks.waypoints import Waypoints

_OPTIONS = EnvOptions(frames=3, image_size=64)
_POOL = 64  # domains in a round


def training_options(**changes: Any) -> EnvOptions:
    """Options of environments as trainings have them, with single fields changed.

    Translations and the step of the physics that are None are the task's.

    Raises:
        ParameterError: There is no such option, or a value is out of range.
    """
    return changed_options(_OPTIONS, changes)


class DomainPool:
    """Pool of domains, one of which each episode gets; a round of the training has a pool of its own.

    It serves as `Worlds.domain`. The domains are drawn beforehand, as drawing colours takes longer than some actions.

    Args:
        draw: Function from a number to its domain.
        size: Number of domains in a round, 1 or more.

    Raises:
        ParameterError: The size is out of range.
    """

    def __init__(self, draw: DomainDraw, size: int = _POOL) -> None:
        require("size", size, size >= 1, "1 or more")
        self._draw, self.size = draw, size
        self.begin(0)

    def begin(self, seed: int) -> None:
        """Draws other domains, which follow from a seed."""
        self._random = np.random.default_rng(seed)
        numbers = self._random.integers(1 << 31, size=self.size)
        self._members = [self._draw(int(number)) for number in numbers]

    def get_state(self) -> dict[str, np.ndarray]:
        """State of the draw, for `set_state`; the domains follow from `begin`."""
        return {"generator": generator_state(self._random)}

    def set_state(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Restores the arrays of `get_state`."""
        set_generator_state(self._random, arrays["generator"])

    def __call__(self, world: int) -> Cousin:
        """Domain of a world's next episode, one of the pool, drawn evenly."""
        return self._members[int(self._random.integers(self.size))]


class TrainingWorlds:
    """Worlds of the same domains, for the state and for images.

    Args:
        scene: The folder of a twin, or what else `load_setup` takes.
        options: Options of the environments; None for `training_options()`. What they leave open of translations
            and of the step of the physics is the task's.
        num_worlds: Number of worlds, W.
        domains: Distribution of the domains; None for cousins with a delta of 0.1.
        yaw: rad, largest turn of the object from the goal at the start, either way; None for the scene's range.

    Attributes:
        setup: The scene, of one world, with the task that a policy's specification names.
        pool: Domains of the episodes; None where every world is the twin.
        waypoints: States in which most episodes begin beside the scene's starts; none at first.

    Raises:
        InputError: The scene, or one of its files, cannot be used.
        ParameterError: An option is out of range.
    """

    def __init__(
        self,
        scene: Scene,
        options: EnvOptions | None = None,
        *,
        num_worlds: int = 64,
        domains: DomainSource | None = None,
        yaw: float | None = None,
    ) -> None:
        loaded, options = load_setup(scene), options or training_options()
        recipe = recipe_of(options.task_in(loaded))
        self.options = dataclasses.replace(
            options,
            max_translation=options.max_translation or recipe.max_translation,
            time_step=options.time_step or recipe.training_step,
        )
        setup = environment_setup(loaded, self.options)
        if yaw is not None:
            setup = with_start_yaw(setup, yaw)
        self.setup, self._num_worlds = setup, num_worlds
        domains = CousinDomains() if domains is None else domains
        draw = domains.draw(setup.twin)
        self.pool = None if draw is None else DomainPool(draw)
        self.waypoints = Waypoints()
        self._about: dict[str, object] = {
            "scene": setup.scenario.name,
            "scene_sha256": scene_hash(setup),
            "task": setup.task.to_document(),
            **domains.about(),
            "start_yaw": list(setup.scenario.start.yaw),
            "disturbance": recipe.disturbance,
            **({"continued": recipe.continued} if recipe.continued else {}),
            **({"retries": recipe.retries} if recipe.retries else {}),
            **({} if recipe.most_force is None else {"most_force": recipe.most_force}),
            **({"light": recipe.light} if recipe.light else {}),
            "latency": list(self.options.latency),
            **({"lag": list(self.options.lag)} if any(self.options.lag) else {}),
            **({"acceleration": self.options.acceleration} if math.isfinite(self.options.acceleration) else {}),
            "view": list(self.options.view),
        }

    @property
    def about(self) -> dict[str, object]:
        """Scene, task, domains and starts, as JSON takes them."""
        return {**self._about, "waypoints": self.waypoints.digest()}

    def task_worlds(self, observation: Kind) -> TaskVecEnv:
        """Worlds of one diagram, with the rewards that the task has for training."""
        task = self.setup.task.for_training()
        options = dataclasses.replace(self.options, observation=observation, task=task)
        env = TaskVecEnv(self.setup, self._num_worlds, options, domain=self.pool)
        worlds, recipe = env.worlds, recipe_of(task)
        worlds.waypoints, worlds.disturbance, worlds.most_force = self.waypoints, recipe.disturbance, recipe.most_force
        worlds.continued, worlds.retries = recipe.continued, recipe.retries
        worlds.light = recipe.light
        return env

    def worlds(self, observation: Kind) -> VecEnv:
        """Worlds for an algorithm: where episodes draw goals, those of the state alone are `TowardGoal`."""
        env, task = self.task_worlds(observation), self.setup.task
        return TowardGoal(env, task) if observation == "state" and task.goal_size else env

    def spec(self, observes: Observes) -> PolicySpec:
        """Specification of a policy that acts in these worlds."""
        return policy_spec(self.setup, self.options, observes)

    def begin(self, seed: int) -> None:
        """Draws the domains of a round."""
        if self.pool is not None:
            self.pool.begin(seed)
