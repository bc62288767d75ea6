# SPDX-License-Identifier: MIT
"""Demonstrations: episodes in which an expert succeeds, their files, and windows of them for sequences of actions."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np
from stable_baselines3.common.vec_env import VecEnv

from pinwm_drake.checkpoints import ArrayFile, digest_of, read_arrays
from pinwm_drake.errors import InputError, ParameterError
from pinwm_drake.files import prepare_folder
from pinwm_drake.learning.evaluation import Acts, result_of
from pinwm_drake.learning.rounds import OnRound
from pinwm_drake.paper.baselines.recording import Act, episode_file, episode_files, record_batch


@dataclass(frozen=True, eq=False)
class Episode(ArrayFile):
    """Recorded episode of T actions.

    Attributes:
        image: (T + 1, height, width, 3) uint8, RGB: what was seen before each action, and at the end.
        pusher: (T + 1, n) float32, along the task's axes across the pusher's box, -1 to 1.
        action: (T, n) float32, in [-1, 1].
    """

    work, wanted = "demonstration", "a recorded episode"

    image: np.ndarray
    pusher: np.ndarray
    action: np.ndarray

    def __len__(self) -> int:
        return len(self.action)

    @classmethod
    def read(cls, path: Path, about: Mapping[str, object] | None = None) -> Self:
        """Read the episode that `write` wrote to a file, whose arrays have to fit together; see `ArrayFile.read`."""
        episode = super().read(path, about)
        image, pusher, action = episode.image, episode.pusher, episode.action
        alike = pusher.ndim == action.ndim == 2 and pusher.shape == (len(action) + 1, action.shape[1])
        seen = image.dtype == np.uint8 and image.ndim == 4 and len(image) == len(pusher) and image.shape[3] == 3
        if not alike or not seen or len(action) == 0:
            given = f"image {image.dtype} {image.shape}, pusher {pusher.shape}, action {action.shape}"
            allowed = "image uint8 (T + 1, height, width, 3), pusher (T + 1, n), action (T, n), T of 1 or more"
            raise InputError(path, value=given, allowed=allowed)
        if not (np.abs(action) <= 1.0).all() or not np.isfinite(pusher).all():
            raise InputError(path, value="others", allowed="finite positions, and actions in [-1, 1]")
        return cls(image, pusher.astype(np.float32), action.astype(np.float32))


def read_demonstrations(folder: Path) -> list[Episode]:
    """Read all recorded episodes of a folder, in the order of their names.

    Raises:
        InputError: There are none, one cannot be read, or they do not fit together.
    """
    paths = episode_files(folder)
    if not paths:
        raise InputError(folder, value="no episode", allowed="a folder with recorded episodes, 00000.npz and so on")
    episodes = [Episode.read(path) for path in paths]
    wanted = (episodes[0].image.shape[1:], episodes[0].action.shape[1])
    for path, one in zip(paths, episodes, strict=True):
        found = (one.image.shape[1:], one.action.shape[1])
        if found != wanted:
            raise InputError(path, value=f"image and action {found}", allowed=f"{wanted}, as in {paths[0].name}")
    return episodes


def digest(episodes: Sequence[Episode]) -> str:
    """SHA-256 of images, positions and actions, which tells demonstrations apart."""
    return digest_of(part for one in episodes for part in (one.image, one.pusher, one.action))


class Windows:
    """Windows of episodes: a few observations, and the actions from the first of them on.

    Every action of an episode is the present one of a window. What lies before an episode's start is its first
    observation or action, and what lies after its end the last one. The official windows end one observation earlier
    than `actions` beyond the end; here episodes are short, and end with success, so that all of them counts.
    """

    def __init__(self, episodes: Sequence[Episode], observations: int, horizon: int) -> None:
        self.image = np.concatenate([one.image[:-1] for one in episodes])
        self.pusher = np.concatenate([one.pusher[:-1] for one in episodes])
        self.action = np.concatenate([one.action for one in episodes])
        lengths = np.array([len(one) for one in episodes])
        ends = np.cumsum(lengths)
        self._first, self._last = np.repeat(ends - lengths, lengths), np.repeat(ends - 1, lengths)
        self._seen, self._done = np.arange(observations), np.arange(horizon)

    def __len__(self) -> int:
        return len(self.action)

    def take(self, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Take windows by the numbers (B,) of their present actions, in all episodes together.

        Returns:
            Images (B, height, width, 3 To) uint8 and positions of the pusher (B, To, n), the oldest first, and actions
            (B, Th, n).
        """
        begin = rows - len(self._seen) + 1
        first, last = self._first[rows, None], self._last[rows, None]
        seen = np.clip(begin[:, None] + self._seen, first, last)
        done = np.clip(begin[:, None] + self._done, first, last)
        images = np.concatenate([self.image[seen[:, k]] for k in range(len(self._seen))], axis=3)
        return images, self.pusher[seen], self.action[done]

    def draw(self, size: int, generator: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Draws windows evenly and with repetition; see `take`."""
        return self.take(generator.integers(len(self), size=size))


_BATCH = "batch"
_TRIES = 10  # episodes for each one that is wanted, before the expert is given up


def collect_demonstrations(
    env: VecEnv,
    expert: Acts,
    folder: Path,
    episodes: int,
    *,
    seed: int = 0,
    about: Mapping[str, object] | None = None,
    on_batch: OnRound | None = None,
) -> None:
    """Record episodes in which an expert succeeds; each is a file `00000.npz` and so on.

    The worlds run batches of one episode each, all of which follow from the seed and the batch's number. A recording
    that was stopped goes on with the same episodes, and so does one that is asked for more.

    Args:
        env: Worlds whose observation has `image` and `pusher` beside what the expert sees, such as "rgb_state".
        expert: Policy or controller that acts, such as a policy of the state.
        folder: Folder of the episodes; made if need be.
        episodes: Number of episodes, 1 or more.
        seed: Seed of the worlds, 0 or more.
        about: Description of worlds and expert, as JSON takes it: a folder with episodes of other ones is refused.
        on_batch: Called with a seed before a batch, to draw its domains.

    Raises:
        ParameterError: The number of episodes is out of range, or the expert fails in nine of ten episodes.
        InputError: The folder holds episodes of another recording, or a file cannot be written.
    """
    if episodes < 1:
        raise ParameterError(f"episodes: got {episodes}; allowed: 1 or more")
    told = {"seed": seed, "worlds": env.num_envs, **(about or {})}
    batch, done = _recorded(prepare_folder(folder), told)
    while done < episodes:
        if batch * env.num_envs >= _TRIES * episodes:
            given = f"{done} successes in {batch * env.num_envs} episodes"
            raise ParameterError(f"expert: got {given}; allowed: one that succeeds in one of {_TRIES} or more")
        recorded = record_batch(env, lambda seed: _acting(expert), batch, seed=seed, on_batch=on_batch)
        found = [
            Episode(one.images, one.pusher, one.actions)
            for one, info in recorded
            if result_of(info, None, len(one), {}).success
        ]
        for one in found[: episodes - done]:
            one.write(episode_file(folder, done), told, **{_BATCH: np.array(batch)})
            done += 1
        batch += 1


def _recorded(folder: Path, about: Mapping[str, object]) -> tuple[int, int]:
    """Return the number of the batch to go on with, and of the episodes before it: the last batch may not be whole."""
    batches: list[int] = []
    while (arrays := read_arrays(episode_file(folder, len(batches)), about, Episode.work, (_BATCH,))) is not None:
        batches.append(int(arrays[_BATCH]))
    return (batches[-1], batches.index(batches[-1])) if batches else (0, 0)


def _acting(expert: Acts) -> Act:
    state: Any = None

    def act(seen: Any, begins: np.ndarray) -> np.ndarray:
        nonlocal state
        actions, state = expert.predict(seen, state=state, episode_start=begins, deterministic=True)
        return actions

    return act
