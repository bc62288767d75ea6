"""Point mass in a picture, a problem of known answer for methods that learn from images.

A dark square slides on white; an action pushes it, and it coasts on. It is to come within 0.15 of the middle of a
picture that spans -1 to 1, in 25 actions. One image does not tell how fast it is.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium import spaces
from stable_baselines3.common.vec_env import VecEnv

from pinwm_drake.checkpoints import generator_state, set_generator_state
from pinwm_drake.learning.spec import CameraSpec, PolicySpec
from pinwm_drake.tasks.push import PushTask
from pinwm_drake.tasks.waypoints import Waypoints

REACH = 0.15  # largest distance of a success
STEPS = 25  # actions of an episode at most
_KEPT, _PUSH = 0.7, 0.1  # share of the velocity that stays, and velocity that an action adds


class PointMass(VecEnv):
    """W points with observation `image`, `pusher`, which is zero, and `state`: place and velocity, then zeros."""

    def __init__(self, num_envs: int = 16, size: int = 64) -> None:
        """Makes worlds with images of `size` px."""
        seen = {
            "image": spaces.Box(0, 255, (size, size, 3), np.uint8),
            "pusher": spaces.Box(-1.0, 1.0, (2,), np.float32),
            "state": spaces.Box(-20.0, 20.0, (11,), np.float32),
        }
        self.size, self.render_mode = size, None
        super().__init__(num_envs, spaces.Dict(seen), spaces.Box(-1.0, 1.0, (2,), np.float32))
        self.seed(0)
        self._place, self._velocity = np.zeros((num_envs, 2)), np.zeros((num_envs, 2))
        self._steps = np.zeros(num_envs, int)

    def seed(self, seed: int | None = None) -> list[int]:
        """Seeds world k with `seed + k`."""
        seeds = [(seed or 0) + world for world in range(self.num_envs)]
        self._generators = [np.random.default_rng(one) for one in seeds]
        return seeds

    def reset(self) -> dict[str, np.ndarray]:
        """Begins an episode in every world."""
        for world in range(self.num_envs):
            self._begin(world)
        return self._see()

    def step_async(self, actions: np.ndarray) -> None:
        """Keeps the actions (W, 2) in [-1, 1]."""
        self._actions = np.clip(actions, -1.0, 1.0)

    def step_wait(self) -> tuple[Any, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        """Goes on by an action; the reward is how much nearer the middle is, and 1 more on success."""
        before = np.linalg.norm(self._place, axis=1)
        self._velocity = _KEPT * self._velocity + _PUSH * self._actions
        moved = np.clip(self._place + self._velocity, -1.0, 1.0)
        self._place, self._velocity = moved, moved - self._place
        self._steps += 1
        distance = np.linalg.norm(self._place, axis=1)
        success = distance < REACH
        ends = success | (self._steps >= STEPS)
        last, infos = self._see(), [{} for _ in ends]
        for world in np.flatnonzero(ends).tolist():
            infos[world] = {
                "distance": float(distance[world]),
                "success": bool(success[world]),
                "TimeLimit.truncated": not success[world],
                "terminal_observation": {name: values[world] for name, values in last.items()},
            }
            self._begin(world)
        return self._see(), (before - distance + success).astype(np.float32), ends, infos

    def get_state(self) -> dict[str, np.ndarray]:
        """Everything that changes, for `set_state`."""
        state = {"place": self._place.copy(), "velocity": self._velocity.copy(), "steps": self._steps.copy()}
        return state | {"generators": np.stack([generator_state(one) for one in self._generators])}

    def set_state(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Restores the arrays of `get_state`."""
        self._place, self._velocity, self._steps = (arrays[name].copy() for name in ("place", "velocity", "steps"))
        for generator, state in zip(self._generators, arrays["generators"], strict=True):
            set_generator_state(generator, state)

    def close(self) -> None:
        """Does nothing: there is nothing to close."""

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """Value of an attribute, once for each world."""
        return [getattr(self, attr_name)] * self.num_envs

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Refuses to set anything."""
        raise NotImplementedError

    def env_method(self, method_name: str, *method_args: Any, indices: Any = None, **method_kwargs: Any) -> list[Any]:
        """Refuses to call anything."""
        raise NotImplementedError

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        """Flags for each world: none is wrapped."""
        return [False] * self.num_envs

    def _begin(self, world: int) -> None:
        place = np.zeros(2)
        while np.linalg.norm(place) < 2.0 * REACH:
            place = self._generators[world].uniform(-0.9, 0.9, 2)
        self._place[world], self._velocity[world], self._steps[world] = place, 0.0, 0

    def _see(self) -> dict[str, np.ndarray]:
        """Observation with the square drawn to a share of a pixel."""
        centres = (np.arange(self.size) + 0.5) / self.size * 2.0 - 1.0
        half, pixel = 0.2, 2.0 / self.size
        # Share of each pixel's row and column that the square covers.
        cover = np.clip((half - np.abs(centres - self._place[..., None])) / pixel + 0.5, 0.0, 1.0)
        dark = cover[:, 1, :, None] * cover[:, 0, None, :]
        image = np.round(255.0 * (1.0 - dark[..., None] * np.array([0.2, 0.9, 0.9]))).astype(np.uint8)
        state = np.zeros((self.num_envs, 11), np.float32)
        state[:, :2], state[:, 2:4] = self._place, self._velocity
        return {"image": image, "pusher": np.zeros((self.num_envs, 2), np.float32), "state": state}


class PointMassWorlds:
    """Worlds as a method asks for them; see `MakeWorlds`."""

    def __init__(self, num_envs: int = 16, size: int = 64) -> None:
        """Keeps number and size of the worlds' images [px]."""
        self._num_envs, self._size = num_envs, size

    @property
    def about(self) -> dict[str, object]:
        """Description of the worlds."""
        return {"scene": "point mass", "size": self._size}

    @property
    def waypoints(self) -> Waypoints:
        """None, as every episode begins anew."""
        return Waypoints()

    def worlds(self, observation: str) -> PointMass:
        """The worlds, whatever observation is asked for."""
        return PointMass(self._num_envs, self._size)

    def spec(self, observes: Any) -> PolicySpec:
        """Specification of a policy; of its task the number of axes alone counts."""
        size = self._size
        camera = CameraSpec(size, size, size, size, size / 2, size / 2, (0.0, 0.0, 0.5), (0.0, 1.0, 0.0, 0.0))
        return PolicySpec(observes, 1, camera, 0.1, 0.02, (-1.0, -1.0), (1.0, 1.0), 0.0, PushTask(), STEPS)

    def begin(self, seed: int) -> None:
        """Draws nothing: all worlds are alike."""


class Wandering:
    """Random actions that stay as they are for some steps, so that the point gets about."""

    def __init__(self, num_envs: int, seed: int) -> None:
        """Begins without an action, with a generator of its own."""
        self._generator = np.random.default_rng(seed)
        self._actions, self._left = np.zeros((num_envs, 2), np.float32), np.zeros(num_envs, int)

    def __call__(self, seen: Any) -> np.ndarray:
        """Actions (W, 2) in [-1, 1]; what is seen does not matter."""
        new = self._left <= 0
        self._actions[new] = self._generator.uniform(-1.0, 1.0, (int(new.sum()), 2))
        self._left[new] = self._generator.integers(1, 9, int(new.sum()))
        self._left -= 1
        return self._actions.copy()

    def predict(
        self, observation: Any, state: None = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[np.ndarray, None]:
        """Actions with the signature of SB3's `predict`."""
        return self(observation), None


class Homing:
    """Answer to the problem, which knows place and velocity: straight to the middle at full speed."""

    def predict(
        self, observation: Any, state: None = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[np.ndarray, None]:
        """Actions (W, 2) with the signature of SB3's `predict`."""
        place, velocity = observation["state"][:, :2], observation["state"][:, 2:4]
        return np.clip(-(place + _KEPT * velocity) / _PUSH, -1.0, 1.0), None
