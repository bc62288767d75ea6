# SPDX-License-Identifier: MIT
"""Recording of episodes, one of each world, with all that was seen and done; on disk a file each."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np
from stable_baselines3.common.vec_env import VecEnv

from pinwm_drake.checkpoints import ArrayFile
from pinwm_drake.errors import InputError
from pinwm_drake.learning.rounds import OnRound
from pinwm_drake.learning.world_evaluation import usual_starts

Act = Callable[[Any, np.ndarray], np.ndarray]
"""Called with an observation and where episodes begin, (W,) bool; gives actions (W, n) in [-1, 1]."""


@dataclass(frozen=True, eq=False)
class Episode(ArrayFile):
    """One episode of T actions.

    Attributes:
        images: (T + 1, height, width, 3) uint8, RGB.
        pusher: (T + 1, n) float32, position of the pusher along the task's axes across its box, -1 to 1.
        actions: (T, n) float32 in [-1, 1].
        rewards: (T,) float32.
        terminated: () bool, true where it ended by success, false where by a limit of time or a failure.
    """

    work, wanted = "collection of episodes", "an episode"

    images: np.ndarray
    pusher: np.ndarray
    actions: np.ndarray
    rewards: np.ndarray
    terminated: np.ndarray

    def __len__(self) -> int:
        return len(self.actions)

    @classmethod
    def read(cls, path: Path, about: Mapping[str, object] | None = None) -> Self:
        """Read the episode that `write` wrote to a file, whose arrays have to fit each other; see `ArrayFile.read`."""
        episode = super().read(path, about)
        steps = len(episode)
        lengths = (len(episode.images), len(episode.pusher), len(episode.rewards))
        if steps < 1 or lengths != (steps + 1, steps + 1, steps):
            given = f"{steps} actions, {lengths[0]} images, {lengths[1]} pushers, {lengths[2]} rewards"
            raise InputError(path, value=given, allowed="T actions and rewards, 1 or more, and T + 1 of the others")
        images, parts = episode.images, (episode.pusher, episode.actions)
        seen = images.dtype == np.uint8 and images.ndim == 4 and images.shape[3] == 3
        if not seen or any(part.ndim != 2 for part in parts) or len({part.shape[1] for part in parts}) != 1:
            given = f"images {images.dtype} {images.shape}, pusher {parts[0].shape}, actions {parts[1].shape}"
            allowed = "images uint8 (T + 1, height, width, 3), pusher (T + 1, n), actions (T, n)"
            raise InputError(path, value=given, allowed=allowed)
        if not (np.abs(episode.actions) <= 1.0).all() or not all(
            np.isfinite(part).all() for part in (episode.pusher, episode.rewards)
        ):
            raise InputError(path, value="others", allowed="finite positions and rewards, and actions in [-1, 1]")
        return episode


def episode_file(folder: Path, number: int) -> Path:
    """File of an episode in a folder, by its number from 0."""
    return folder / f"{number:05}.npz"


def episode_files(folder: Path) -> list[Path]:
    """Files of the episodes of a folder, in order, and not what a run that was killed left half-written."""
    return sorted(folder.glob("[0-9]*.npz"))


def read_episodes(folder: Path) -> list[Episode]:
    """Episodes of a folder; none where it has none. Raises InputError where one of them cannot be read."""
    return [Episode.read(path) for path in episode_files(folder)]


def record_batch(
    env: VecEnv, make_act: Callable[[int], Act], number: int, *, seed: int, on_batch: OnRound | None
) -> list[tuple[Episode, dict[str, Any]]]:
    """Record a batch of episodes, all of which follow from the seed and the batch's number; see `record_episodes`."""
    domains, worlds, own = np.random.SeedSequence(seed, spawn_key=(number,)).generate_state(3) >> 1
    if on_batch is not None:
        on_batch(int(domains))
    return record_episodes(env, make_act(int(own)), int(worlds))


def record_episodes(env: VecEnv, act: Act, seed: int) -> list[tuple[Episode, dict[str, Any]]]:
    """Record one episode of each world; all begin where the scene says.

    Args:
        env: Worlds whose observation has `image`, whose last three channels are kept, and `pusher`.
        act: Function that acts.
        seed: Seed of the first world; world k has `seed + k`.

    Returns:
        The episodes and what the worlds said at their ends, as SB3's `infos` have it, in the order of the worlds.
    """
    with usual_starts(env):
        env.seed(seed)
        return _recorded(env, act)


def _recorded(env: VecEnv, act: Act) -> list[tuple[Episode, dict[str, Any]]]:
    W = env.num_envs
    seen: Any = env.reset()
    images, pushers = [[_last(one)] for one in seen["image"]], [[one.copy()] for one in seen["pusher"]]
    taken: list[list[np.ndarray]] = [[] for _ in range(W)]
    rewards: list[list[float]] = [[] for _ in range(W)]
    found: dict[int, tuple[Episode, dict[str, Any]]] = {}
    begins = np.ones(W, bool)
    while len(found) < W:
        actions = np.clip(act(seen, begins), -1.0, 1.0).astype(np.float32)
        seen, gained, begins, infos = env.step(actions)
        for world in set(range(W)) - found.keys():
            ended, info = begins[world], infos[world]
            last = info["terminal_observation"] if ended else {name: seen[name][world] for name in ("image", "pusher")}
            images[world].append(_last(last["image"]))
            pushers[world].append(last["pusher"].copy())
            taken[world].append(actions[world].copy())
            rewards[world].append(float(gained[world]))
            if ended:
                episode = Episode(
                    np.stack(images[world]),
                    np.stack(pushers[world]).astype(np.float32),
                    np.stack(taken[world]),
                    np.array(rewards[world], np.float32),
                    np.array(not info.get("TimeLimit.truncated", False)),
                )
                found[world] = episode, info
    return [found[world] for world in range(W)]


def _last(image: np.ndarray) -> np.ndarray:
    """Return the last image (height, width, 3) of a stack, copied."""
    return image[..., -3:].copy()
