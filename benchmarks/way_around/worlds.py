# SPDX-License-Identifier: MIT
"""Worlds in which a point goes around a disc, seen in small images, and an expert that takes either way."""

from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.scenes.small_worlds import MakeSmallWorlds, SmallWorlds
from pinwm_drake.learning.evaluation import Evaluation
from pinwm_drake.learning.world_evaluation import evaluate_worlds

SIZE = 32  # px
FIELD = 1.2  # half of what an image shows
DISC, GOAL, ACROSS = 0.25, 0.15, 0.7  # radii of the disc and of the goal; from the disc's middle to start and goal
STEP, LONGEST = 0.12, 40  # length of the longest action; number of actions in an episode
WIDE = 0.5  # from the disc's middle to where the expert passes it


class AroundWorlds(SmallWorlds):
    """W points, which start left of a disc and are to reach the goal right of it; to touch the disc ends an episode.

    The disc's place is drawn, and so is the height of the start, a little. `pusher` is the point's place, `state` (4,)
    the point's and the disc's.
    """

    changing = ("place", "disc")

    def __init__(self, num_envs: int = 32) -> None:
        super().__init__(num_envs, SIZE, 4, LONGEST)
        self.place, self.disc = np.zeros((num_envs, 2)), np.zeros((num_envs, 2))

    def begin(self, world: int, generator: np.random.Generator) -> None:
        """Draws the places of disc and point."""
        self.disc[world] = generator.uniform([-0.2, -0.3], [0.2, 0.3])
        self.place[world] = self.disc[world] + [-ACROSS, generator.uniform(-0.05, 0.05)]

    def move(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Move the points by actions, whose norm counts up to 1; an episode ends at the goal or at the disc."""
        actions = actions / np.maximum(np.linalg.norm(actions, axis=1, keepdims=True), 1.0)
        self.place = np.clip(self.place + STEP * actions, -1.0, 1.0)
        distance = np.linalg.norm(self.place - self.disc - [ACROSS, 0.0], axis=1)
        success = distance < GOAL
        failed = ~success & (np.linalg.norm(self.place - self.disc, axis=1) < DISC)
        return success, distance, success, failed

    def see(self) -> dict[str, np.ndarray]:
        """Observation of all worlds."""
        along = FIELD * (2.0 * (np.arange(SIZE) + 0.5) / SIZE - 1.0)
        image = np.full((self.num_envs, SIZE, SIZE, 3), 255, np.uint8)
        goal = self.disc + np.array([ACROSS, 0.0])
        for middle, radius, colour in (
            (self.disc, DISC, (90, 90, 90)),
            (goal, GOAL, (60, 160, 60)),
            (self.place, 0.1, (40, 60, 200)),
        ):
            x, y = along - middle[:, :1], along - middle[:, 1:]
            image[x[:, None, :] ** 2 + y[:, :, None] ** 2 < radius**2] = colour
        state = np.concatenate([self.place, self.disc], 1).astype(np.float32)
        return {"image": image, "pusher": self.place.astype(np.float32), "state": state}


class Expert:
    """Expert that passes the disc above or below, as chance has it in each episode."""

    def __init__(self, seed: int = 0) -> None:
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
        self._generator = np.random.default_rng(seed)

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[np.ndarray, None]:
        """Actions (W, 2) in [-1, 1]^2."""
        return self._generator.uniform(-1.0, 1.0, (len(observation["pusher"]), 2)), None


class MakeAround(MakeSmallWorlds):
    """Maker of these worlds."""

    def __init__(self) -> None:
        super().__init__({"scene": "way_around"}, STEP)

    def worlds(self, observation: str) -> AroundWorlds:
        """Worlds with image and state."""
        return AroundWorlds()


def success(policy: Any, episodes: int = 200) -> Evaluation:
    """Return the evaluation of a policy in episodes of its own."""
    return evaluate_worlds(AroundWorlds(), policy, episodes, seed=7_000)


def sides(folder: Path) -> np.ndarray:
    """Sides (N,) on which the recorded episodes of a folder passed, -1 or 1."""
    from pinwm_drake.paper.baselines.diffusion.demonstrations import read_demonstrations

    turns = [one.pusher[:, 1] - one.pusher[0, 1] for one in read_demonstrations(folder)]
    return np.array([np.sign(turn[np.abs(turn).argmax()]) for turn in turns])
