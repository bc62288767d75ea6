# SPDX-License-Identifier: MIT
"""Worlds that are quick to learn: a dark square on white is to be moved to the middle, by actions that move it."""

import numpy as np
from gymnasium import spaces
from stable_baselines3.common.vec_env import VecEnv

from pinwm_drake.checkpoints import generator_state, set_generator_state
from pinwm_drake.learning.spec import CameraSpec, PolicySpec
from pinwm_drake.tasks.push import PushTask

SIZE = 16  # px


def toy_spec(observes="rgb", frames=2, **changes):
    camera = CameraSpec(SIZE, SIZE, 20.0, 20.0, SIZE / 2, SIZE / 2, (0.0, 0.0, 0.5), (0.0, 1.0, 0.0, 0.0))
    values = {
        "observes": observes,
        "frames": frames,
        "camera": camera,
        "horizon": 0.1,
        "max_translation": 0.02,
        "pusher_low": (-0.3, -0.2),
        "pusher_high": (0.3, 0.4),
        "pusher_height": 0.02,
        "task": PushTask(),
        "max_steps": 20,
    }
    return PolicySpec(**(values | changes))


class ToyWorlds(VecEnv):
    """W squares; an action moves each by up to a tenth of the picture, and 0.15 from the middle is a success."""

    def __init__(self, num_envs=8, images=True, frames=2):
        state = spaces.Box(-20.0, 20.0, (11,), np.float32)
        seen = {
            "image": spaces.Box(0, 255, (SIZE, SIZE, 3 * frames), np.uint8),
            "pusher": spaces.Box(-1.0, 1.0, (2,), np.float32),
            "state": state,
        }
        space = spaces.Dict(seen) if images else state
        super().__init__(num_envs, space, spaces.Box(-1.0, 1.0, (2,), np.float32))
        self._images, self._frames = images, frames
        self._generators = [np.random.default_rng() for _ in range(num_envs)]
        self._place, self._steps = np.zeros((num_envs, 2)), np.zeros(num_envs, int)

    def seed(self, seed=None):
        self._generators = [np.random.default_rng(seed + world) for world in range(self.num_envs)]
        return [seed + world for world in range(self.num_envs)]

    def reset(self):
        for world in range(self.num_envs):
            self._begin(world)
        return self._see()

    def step_async(self, actions):
        self._actions = np.clip(actions, -1.0, 1.0)

    def step_wait(self):
        before = np.abs(self._place).sum(1)
        self._place = np.clip(self._place + 0.2 * self._actions, -1.0, 1.0)
        self._shift()
        self._steps += 1
        distance = np.linalg.norm(self._place, axis=1)
        success = distance < 0.15
        dones = success | (self._steps >= 20)
        rewards = (before - np.abs(self._place).sum(1) + success).astype(np.float32)
        infos = [
            {
                "distance": float(distance[w]),
                "angle": 0.0,
                "success": bool(success[w]),
                "step": int(self._steps[w]),
                "TimeLimit.truncated": bool(dones[w] and not success[w]),
            }
            for w in range(self.num_envs)
        ]
        last = self._see()
        for world in np.flatnonzero(dones):
            infos[world]["terminal_observation"] = self._of(last, world)
            self._begin(world)
        return self._see(), rewards, dones, infos

    def get_state(self):
        state = {"place": self._place.copy(), "steps": self._steps.copy(), "stack": self._stack.copy()}
        return state | {"generators": np.stack([generator_state(one) for one in self._generators])}

    def set_state(self, arrays):
        self._place, self._steps, self._stack = (arrays[name].copy() for name in ("place", "steps", "stack"))
        for generator, state in zip(self._generators, arrays["generators"], strict=True):
            set_generator_state(generator, state)

    def close(self):
        pass

    def get_attr(self, attr_name, indices=None):
        return [None] * self.num_envs

    def set_attr(self, attr_name, value, indices=None):
        raise NotImplementedError

    def env_method(self, method_name, *method_args, indices=None, **method_kwargs):
        raise NotImplementedError

    def env_is_wrapped(self, wrapper_class, indices=None):
        return [False] * self.num_envs

    def _begin(self, world):
        self._place[world] = self._generators[world].uniform(-0.8, 0.8, 2)
        self._steps[world] = 0
        if not hasattr(self, "_stack"):
            self._stack = np.full((self.num_envs, SIZE, SIZE, 3 * self._frames), 255, np.uint8)
        self._stack[world] = np.tile(self._picture(world), (1, 1, self._frames))

    def _shift(self):
        for world in range(self.num_envs):
            self._stack[world] = np.concatenate([self._stack[world][..., 3:], self._picture(world)], axis=2)

    def _picture(self, world):
        picture = np.full((SIZE, SIZE, 3), 255, np.uint8)
        x, y = ((self._place[world] + 1.0) / 2.0 * (SIZE - 4)).round().astype(int)
        picture[y : y + 4, x : x + 4] = [200, 30, 30]
        return picture

    def _see(self):
        state = np.zeros((self.num_envs, 11), np.float32)
        state[:, :2] = self._place
        state[:, 2] = 1.0
        if not self._images:
            return state
        return {"image": self._stack.copy(), "pusher": np.zeros((self.num_envs, 2), np.float32), "state": state}

    @staticmethod
    def _of(seen, world):
        return {name: values[world] for name, values in seen.items()} if isinstance(seen, dict) else seen[world]
