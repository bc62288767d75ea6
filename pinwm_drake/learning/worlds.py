# SPDX-License-Identifier: MIT
"""Worlds as learners see them."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper
from stable_baselines3.common.vec_env.base_vec_env import VecEnvStepReturn

from pinwm_drake.checkpoints import Resumable
from pinwm_drake.errors import ParameterError
from pinwm_drake.tasks.task import Task

_GOAL = "toward_goal"


class SeenWorlds(VecEnvWrapper):
    """Worlds whose observations a learner sees in another way; the same ones here."""

    def seen(self, observation: Any) -> Any:
        """Return the learner's observation, of that of all worlds."""
        return observation

    def last(self, observation: Any) -> Any:
        """Return the learner's observation, of the last one of an episode in one world."""
        return observation

    def reset(self) -> Any:
        """Begins an episode in every world, and gives their observation."""
        return self.seen(self.venv.reset())

    def step_wait(self) -> VecEnvStepReturn:
        """Outcome of the step: observation, rewards (W,), ends of episodes (W,) bool, and infos."""
        seen, rewards, ended, infos = self.venv.step_wait()
        for info in infos:
            if "terminal_observation" in info:
                info["terminal_observation"] = self.last(info["terminal_observation"])
        return self.seen(seen), rewards, ended, infos


class TowardGoal(SeenWorlds):
    """Worlds whose episodes draw their goals, for a policy of a state that is told from the goal.

    They take actions as towards the task's own goal; where they show no images, they show the state alone. Object and
    pusher that are moved along with the goal are the same to such a policy: what it learns holds for all goals.
    """

    def __init__(self, env: VecEnv, task: Task) -> None:
        """Wrap worlds whose observation is a dict of `state` and `goal`, or of images, pusher and these."""
        space: Any = env.observation_space
        self._bare = "image" not in space.spaces
        super().__init__(env, space["state"] if self._bare else space)
        self._task, self._goal = task, np.zeros((env.num_envs, task.goal_size), np.float32)

    def step_async(self, actions: np.ndarray) -> None:
        """Begins a step by actions (W, n) in [-1, 1]^n towards the task's own goal."""
        given = torch.from_numpy(np.asarray(actions, np.float32))
        self.venv.step_async(self._task.world_action(given, torch.from_numpy(self._goal)).numpy())

    def seen(self, observation: Any) -> Any:
        """Return the state, where there are no images; otherwise the observation."""
        self._goal = observation["goal"]
        return self.last(observation)

    def last(self, observation: Any) -> Any:
        """Return the state, where there are no images; otherwise the observation."""
        return observation["state"] if self._bare else observation

    def get_state(self) -> dict[str, np.ndarray]:
        """Everything that changes in the worlds, for `set_state`."""
        return {**self._resumable.get_state(), _GOAL: self._goal.copy()}

    def set_state(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Restores the arrays of `get_state`."""
        self._goal = arrays[_GOAL].copy()
        self._resumable.set_state({name: values for name, values in arrays.items() if name != _GOAL})

    @property
    def _resumable(self) -> Resumable:
        if not isinstance(self.venv, Resumable):
            raise ParameterError("worlds: got some that cannot be kept; allowed: those with get_state and set_state")
        return self.venv
