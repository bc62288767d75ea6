# SPDX-License-Identifier: MIT
"""The frame that a policy sees and acts in, where its task is the same at any yaw: x is from the object to the pusher.

What was learned at one yaw is so known at all of them.
"""

from typing import Any

import numpy as np
import torch
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.common.vec_env import VecEnv
from torch import Tensor, nn

from pinwm_drake.learning.worlds import SeenWorlds
from pinwm_drake.tasks.registry import recipe_of
from pinwm_drake.tasks.task import Task


class Heading(nn.Module):
    """Turn about the world's z that brings the pusher to y = 0, x > 0 of a task's state; none where the task has none.

    The world's x stands in for a pusher right above the object.
    """

    def __init__(self, task: Task) -> None:
        super().__init__()
        recipe = recipe_of(task)
        self._pusher, self._vectors = recipe.heading, recipe.level_vectors
        self._state_size, self._action_size = task.state_size, task.action_size

    def state(self, state: Tensor) -> Tensor:
        """States (B, state_size), whose level vectors are told along the heading and across it.

        What was before them, as `tasks.history` has it, may follow; it is told along the heading of now.
        """
        if self._pusher is None:
            return state
        c, s = self._direction(state)
        columns = list(state.unbind(1))
        for k in self._all_vectors(len(columns)):
            x, y = columns[k], columns[k + 1]
            columns[k], columns[k + 1] = c * x + s * y, c * y - s * x
        return torch.stack(columns, 1)

    def action(self, action: Tensor, state: Tensor) -> Tensor:
        """Actions (B, n) along the world's axes, of norm 1 at most.

        Args:
            action: (B, n) along and across the heading, in [-1, 1].
            state: (B, state_size), of the world's axes, by which the heading is found; a history may follow.
        """
        if self._pusher is None:
            return action
        c, s = self._direction(state)
        x, y, *others = (action / torch.linalg.vector_norm(action, dim=1, keepdim=True).clamp(min=1.0)).unbind(1)
        return torch.stack([c * x - s * y, s * x + c * y, *others], 1)

    def along(self, action: Tensor, state: Tensor) -> Tensor:
        """Actions (B, n) along and across the heading, of actions along the world's axes; the inverse of `action`."""
        if self._pusher is None:
            return action
        c, s = self._direction(state)
        x, y, *others = action.unbind(1)
        return torch.stack([c * x + s * y, c * y - s * x, *others], 1)

    def _all_vectors(self, size: int) -> list[int]:
        """Return indices of each vector's x in a state with a history: those of states and of actions."""
        begins = range(self._state_size, size, self._state_size + self._action_size)
        past = [begin + k for begin in begins for k in (*self._vectors, self._state_size)]
        return [*self._vectors, *past]

    def _direction(self, state: Tensor) -> tuple[Tensor, Tensor]:
        """Cosine and sine (B,) of the yaw of the heading."""
        assert self._pusher is not None
        x, y = state[:, self._pusher], state[:, self._pusher + 1]
        far = torch.sqrt(x * x + y * y)
        above, far = far < 1e-6, far.clamp(min=1e-6)
        return torch.where(above, torch.ones_like(x), x / far), torch.where(above, torch.zeros_like(y), y / far)


class HeadingExtractor(BaseFeaturesExtractor):
    """Extractor of SB3's networks that tells a task's state along its heading."""

    def __init__(self, observation_space: Any, task: Task) -> None:
        super().__init__(observation_space, observation_space.shape[0])
        self._heading = Heading(task)

    def forward(self, state: Tensor) -> Tensor:
        """Features (B, k) of states (B, k)."""
        return self._heading.state(state)


class AlongHeading(SeenWorlds):
    """Worlds that take actions along the heading of the state that they showed last."""

    def __init__(self, env: VecEnv, task: Task) -> None:
        """Wrap worlds whose observation is the task's state, or a dict with `state`."""
        super().__init__(env)
        self._heading = Heading(task)
        self._state = np.zeros((env.num_envs, task.state_size), np.float32)

    def step_async(self, actions: np.ndarray) -> None:
        """Begins a step by actions (W, n) along the heading."""
        given = torch.from_numpy(np.asarray(actions, np.float32))
        self.venv.step_async(self._heading.action(given, torch.from_numpy(self._state)).numpy())

    def seen(self, observation: Any) -> Any:
        """Take an observation, the state or a dict with `state`, as the last one, and give it back."""
        self._state = observation["state"] if isinstance(observation, dict) else observation
        return observation
