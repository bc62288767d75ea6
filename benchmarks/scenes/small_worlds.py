# SPDX-License-Identifier: MIT
"""Small worlds of arrays for Stable-Baselines3, on which methods that learn from images can be tried."""

from abc import abstractmethod
from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium import spaces
from stable_baselines3.common.vec_env import VecEnv

from pinwm_drake.checkpoints import generator_state, set_generator_state
from pinwm_drake.learning.spec import CameraSpec, Observes, PolicySpec
from pinwm_drake.tasks.push import PushTask
from pinwm_drake.tasks.waypoints import Waypoints


class SmallWorlds(VecEnv):
    """W worlds with observation `image`, `pusher` (2,) and `state` (n,); what ends begins anew in the same step.

    Attributes:
        changing: Names of the attributes, arrays (W, ...), that a subclass's worlds change.
        longest: Number of actions of an episode at most.
    """

    changing: tuple[str, ...] = ()

    def __init__(self, num_envs: int, size: int, state_size: int, longest: int) -> None:
        seen = {
            "image": spaces.Box(0, 255, (size, size, 3), np.uint8),
            "pusher": spaces.Box(-1.0, 1.0, (2,), np.float32),
            "state": spaces.Box(-np.inf, np.inf, (state_size,), np.float32),
        }
        self.size, self.longest, self.render_mode = size, longest, None
        super().__init__(num_envs, spaces.Dict(seen), spaces.Box(-1.0, 1.0, (2,), np.float32))
        self.seed(0)
        self._steps, self._actions = np.zeros(num_envs, int), np.zeros((num_envs, 2))

    @abstractmethod
    def begin(self, world: int, generator: np.random.Generator) -> None:
        """Draws the beginning of an episode of a world."""

    @abstractmethod
    def move(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Goes on by actions (W, 2); gives (W,) each: reward, distance from the goal, success, failure for good."""

    @abstractmethod
    def see(self) -> dict[str, np.ndarray]:
        """Observation of all worlds."""

    def seed(self, seed: int | None = None) -> list[int | None]:
        """Seeds world k with `seed + k`."""
        seeds: list[int | None] = [(seed or 0) + world for world in range(self.num_envs)]
        self._generators = [np.random.default_rng(one) for one in seeds]
        return seeds

    def reset(self) -> Any:
        """Begins an episode in every world."""
        for world in range(self.num_envs):
            self._begin(world)
        return self.see()

    def step_async(self, actions: np.ndarray) -> None:
        """Keep the actions (W, 2)."""
        self._actions = actions

    def step_wait(self) -> Any:
        """Goes on by an action."""
        reward, distance, success, failed = self.move(self._actions)
        self._steps += 1
        late = (self._steps >= self.longest) & ~success & ~failed
        ends = success | failed | late
        last = self.see()
        infos: list[dict[str, Any]] = [{} for _ in ends]
        for world in np.flatnonzero(ends).tolist():
            infos[world] = {
                "distance": float(distance[world]),
                "success": bool(success[world]),
                "TimeLimit.truncated": bool(late[world]),
                "terminal_observation": {name: values[world] for name, values in last.items()},
            }
            self._begin(world)
        return self.see(), reward.astype(np.float32), ends, infos

    def get_state(self) -> dict[str, np.ndarray]:
        """Everything that changes, for `set_state`."""
        state = {name: getattr(self, name).copy() for name in self.changing}
        generators = np.stack([generator_state(one) for one in self._generators])
        return state | {"steps": self._steps.copy(), "generators": generators}

    def set_state(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Restores the arrays of `get_state`."""
        for name in self.changing:
            setattr(self, name, arrays[name].copy())
        self._steps = arrays["steps"].copy()
        for generator, state in zip(self._generators, arrays["generators"], strict=True):
            set_generator_state(generator, state)

    def close(self) -> None:
        """Do nothing: there is nothing to close."""

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
        """Flag for each world: none is wrapped."""
        return [False] * self.num_envs

    def _begin(self, world: int) -> None:
        self._steps[world] = 0
        self.begin(world, self._generators[world])


class MakeSmallWorlds:
    """Maker of small worlds, as methods take it; see `MakeWorlds`."""

    waypoints = Waypoints()

    def __init__(self, about: dict[str, object], step: float) -> None:
        self.about, self._step = about, step

    def worlds(self, observation: str) -> SmallWorlds:
        """Return the worlds, whatever observation is asked for."""
        raise NotImplementedError

    def spec(self, observes: Observes) -> PolicySpec:
        """Specification of a policy of one image; its camera and task are of no account here."""
        worlds = self.worlds(observes)
        size = worlds.size
        camera = CameraSpec(size, size, size, size, size / 2, size / 2, (0.0, 0.0, 0.5), (0.0, 1.0, 0.0, 0.0))
        low, high = (-1.0, -1.0), (1.0, 1.0)
        return PolicySpec(observes, 1, camera, 0.1, self._step, low, high, 0.0, PushTask(), worlds.longest)

    def begin(self, seed: int) -> None:
        """Draws nothing: all worlds are alike."""
