"""Worlds in which a point goes around a disc, seen in small images, and an expert that takes either way."""

from pathlib import Path
from typing import Any

import numpy as np
from gymnasium import spaces
from stable_baselines3.common.vec_env import VecEnv

from pinwm_drake.checkpoints import generator_state, set_generator_state
from pinwm_drake.learning.evaluation import Evaluation
from pinwm_drake.learning.spec import CameraSpec, Observes, PolicySpec
from pinwm_drake.learning.world_evaluation import evaluate_worlds
from pinwm_drake.tasks.push import PushTask
from pinwm_drake.tasks.waypoints import Waypoints

SIZE = 32  # px
FIELD = 1.2  # half of what an image shows
DISC, GOAL, ACROSS = 0.25, 0.15, 0.7  # radii of the disc and of the goal; from the disc's middle to start and goal
STEP, LONGEST = 0.12, 40  # length of the longest action; number of actions in an episode
WIDE = 0.5  # from the disc's middle to where the expert passes it


class AroundWorlds(VecEnv):
    """W points, which start left of a disc and are to reach the goal right of it; to touch the disc ends an episode.

    The disc's place is drawn, and so is the height of the start, a little. Observation: `image`, `pusher` (2,), the
    point's place, and `state` (4,), the point's and the disc's.
    """

    def __init__(self, num_envs: int = 32) -> None:
        """Begins no episode yet."""
        seen = {
            "image": spaces.Box(0, 255, (SIZE, SIZE, 3), np.uint8),
            "pusher": spaces.Box(-1.0, 1.0, (2,), np.float32),
            "state": spaces.Box(-np.inf, np.inf, (4,), np.float32),
        }
        super().__init__(num_envs, spaces.Dict(seen), spaces.Box(-1.0, 1.0, (2,), np.float32))
        self._generators = [np.random.default_rng() for _ in range(num_envs)]
        self._place, self._disc = np.zeros((num_envs, 2)), np.zeros((num_envs, 2))
        self._steps, self._actions = np.zeros(num_envs, int), np.zeros((num_envs, 2))

    def seed(self, seed: int | None = None) -> list[int | None]:
        """Seeds world k with `seed + k`."""
        first = 0 if seed is None else seed
        self._generators = [np.random.default_rng(first + world) for world in range(self.num_envs)]
        return [first + world for world in range(self.num_envs)]

    def reset(self) -> Any:
        """Begins an episode in every world."""
        for world in range(self.num_envs):
            self._begin(world)
        return self._see()

    def step_async(self, actions: np.ndarray) -> None:
        """Keeps the actions (W, 2), whose norm counts up to 1."""
        self._actions = actions / np.maximum(np.linalg.norm(actions, axis=1, keepdims=True), 1.0)

    def step_wait(self) -> Any:
        """Moves the points; an episode ends at the goal, at the disc, or after `LONGEST` actions."""
        self._place = np.clip(self._place + STEP * self._actions, -1.0, 1.0)
        self._steps += 1
        distance = np.linalg.norm(self._place - self._disc - [ACROSS, 0.0], axis=1)
        success = distance < GOAL
        ended = success | (np.linalg.norm(self._place - self._disc, axis=1) < DISC) | (self._steps >= LONGEST)
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        last = self._see()
        for world in np.flatnonzero(ended).tolist():
            infos[world] = {
                "distance": float(distance[world]),
                "success": bool(success[world]),
                "terminal_observation": {name: values[world] for name, values in last.items()},
            }
            self._begin(world)
        return self._see(), success.astype(np.float32), ended, infos

    def get_state(self) -> dict[str, np.ndarray]:
        """Everything that changes, for `set_state`."""
        generators = np.stack([generator_state(one) for one in self._generators])
        arrays = {"place": self._place, "disc": self._disc, "steps": self._steps}
        return {name: values.copy() for name, values in arrays.items()} | {"generators": generators}

    def set_state(self, arrays: Any) -> None:
        """Restores the arrays of `get_state`."""
        self._place, self._disc, self._steps = (arrays[name].copy() for name in ("place", "disc", "steps"))
        for generator, state in zip(self._generators, arrays["generators"], strict=True):
            set_generator_state(generator, state)

    def close(self) -> None:
        """Does nothing: there is nothing to close."""

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """Nothing for each world but `render_mode`, which is None."""
        if attr_name != "render_mode":
            raise AttributeError(attr_name)
        return [None] * self.num_envs

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Raises NotImplementedError."""
        raise NotImplementedError

    def env_method(self, method_name: str, *method_args: Any, indices: Any = None, **method_kwargs: Any) -> list[Any]:
        """Raises NotImplementedError."""
        raise NotImplementedError

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        """Flags: no world is wrapped."""
        return [False] * self.num_envs

    def _begin(self, world: int) -> None:
        generator = self._generators[world]
        self._disc[world] = generator.uniform([-0.2, -0.3], [0.2, 0.3])
        self._place[world] = self._disc[world] + [-ACROSS, generator.uniform(-0.05, 0.05)]
        self._steps[world] = 0

    def _see(self) -> Any:
        along = FIELD * (2.0 * (np.arange(SIZE) + 0.5) / SIZE - 1.0)
        image = np.full((self.num_envs, SIZE, SIZE, 3), 255, np.uint8)
        goal = self._disc + np.array([ACROSS, 0.0])
        for middle, radius, colour in (
            (self._disc, DISC, (90, 90, 90)),
            (goal, GOAL, (60, 160, 60)),
            (self._place, 0.1, (40, 60, 200)),
        ):
            x, y = along - middle[:, :1], along - middle[:, 1:]
            image[x[:, None, :] ** 2 + y[:, :, None] ** 2 < radius**2] = colour
        state = np.concatenate([self._place, self._disc], 1).astype(np.float32)
        return {"image": image, "pusher": self._place.astype(np.float32), "state": state}


class Expert:
    """Expert that passes the disc above or below, as chance has it in each episode."""

    def __init__(self, seed: int = 0) -> None:
        """Seeds the choice of the ways."""
        self._generator = np.random.default_rng(seed)

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[np.ndarray, Any]:
        """Actions (W, 2), and the way (W,) of each world, -1 or 1."""
        seen = observation["state"]
        drawn = self._generator.choice([-1.0, 1.0], len(seen))
        way = drawn if state is None else np.where(episode_start, drawn, state)
        place, disc = seen[:, :2], seen[:, 2:]
        before = place[:, 0] < disc[:, 0] - 0.05
        aim = disc + np.where(before[:, None], np.stack([0.0 * way, WIDE * way], 1), [ACROSS, 0.0])
        action = (aim - place) / STEP
        return action / np.maximum(np.linalg.norm(action, axis=1, keepdims=True), 1.0), way


class Anyhow:
    """Policy whose actions are evenly random."""

    def __init__(self, seed: int = 0) -> None:
        """Seeds the actions."""
        self._generator = np.random.default_rng(seed)

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[np.ndarray, None]:
        """Actions (W, 2) in [-1, 1]^2."""
        return self._generator.uniform(-1.0, 1.0, (len(observation["pusher"]), 2)), None


class MakeAround:
    """Maker of these worlds, as methods take it."""

    about: dict[str, object] = {"scene": "way_around"}  # noqa: RUF012  # as `MakeWorlds` has it
    waypoints = Waypoints()

    def worlds(self, observation: str) -> AroundWorlds:
        """Worlds with image and state."""
        return AroundWorlds()

    def spec(self, observes: Observes) -> PolicySpec:
        """Specification of a policy of one image; its camera and task are of no account here."""
        return PolicySpec(
            observes=observes,
            frames=1,
            camera=CameraSpec(SIZE, SIZE, 40.0, 40.0, SIZE / 2, SIZE / 2, (0.0, 0.0, 1.0), (0.0, 1.0, 0.0, 0.0)),
            horizon=0.1,
            max_translation=STEP,
            pusher_low=(-1.0, -1.0),
            pusher_high=(1.0, 1.0),
            pusher_height=0.0,
            task=PushTask(),
            max_steps=LONGEST,
        )

    def begin(self, seed: int) -> None:
        """Does nothing: the worlds have one domain."""


def success(policy: Any, episodes: int = 200) -> Evaluation:
    """Evaluation of a policy in episodes of its own."""
    return evaluate_worlds(AroundWorlds(), policy, episodes, seed=7_000)


def sides(folder: Path) -> np.ndarray:
    """Sides (N,) on which the recorded episodes of a folder passed, -1 or 1."""
    from pinwm_drake.paper.baselines.diffusion.demonstrations import read_demonstrations

    turns = [one.pusher[:, 1] - one.pusher[0, 1] for one in read_demonstrations(folder)]
    return np.array([np.sign(turn[np.abs(turn).argmax()]) for turn in turns])
