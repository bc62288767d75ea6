# SPDX-License-Identifier: MIT
"""A tiny task with the infos of the push task: a number is to be brought to zero, by one at most in a step."""

import gymnasium
import numpy as np
from gymnasium import spaces


class Ramp(gymnasium.Env):
    """It starts at 1 to 9; `broken_at` names a value at which its physics fails."""

    def __init__(self, max_steps: int = 6, broken_at: int | None = None) -> None:
        self.observation_space = spaces.Box(-20.0, 20.0, (1,), np.float64)
        self.action_space = spaces.Box(-1.0, 1.0, (1,), np.float64)
        self.max_steps, self.broken_at = max_steps, broken_at
        self.value, self.count = 0.0, 0

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.value, self.count = float(self.np_random.integers(1, 10)), 0
        return self.see(), self.info()

    def step(self, action):
        self.count += 1
        if self.value == self.broken_at:
            return self.see(), 0.0, False, True, self.info() | {"failure": "no solution"}
        self.value += float(np.clip(action[0], -1.0, 1.0))
        done = self.info()["success"]
        return self.see(), 0.0, done, self.count >= self.max_steps and not done, self.info()

    def see(self):
        return np.array([self.value])

    def info(self):
        return {"distance": abs(self.value), "angle": 0.0, "success": abs(self.value) < 0.5}


class Down:
    """Goes towards zero; counts the episodes that it is told of."""

    def __init__(self) -> None:
        self.begun = 0

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        assert deterministic
        self.begun += int(np.sum(episode_start))
        return -np.sign(observation), 1 + (state or 0)


class Drawn:
    """Draws from the environment's action space."""

    def __init__(self, space: spaces.Space) -> None:
        self.space = space

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        return self.space.sample(), None
