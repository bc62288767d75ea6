"""Recording of demonstrations: episodes in which an expert succeeds, in worlds for images."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from stable_baselines3.common.vec_env import VecEnv

from pinwm_drake.checkpoints import read_arrays
from pinwm_drake.errors import ParameterError
from pinwm_drake.files import prepare_folder
from pinwm_drake.learning.evaluation import Acts, result_of
from pinwm_drake.learning.rounds import OnRound
from pinwm_drake.paper.baselines.diffusion.demonstrations import Episode, episode_path
from pinwm_drake.paper.baselines.recording import record_episodes

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
    """Records episodes in which an expert succeeds; each is a file `00000.npz` and so on.

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
        words = np.random.SeedSequence(seed, spawn_key=(batch,)).generate_state(2)
        if on_batch is not None:
            on_batch(int(words[0] >> 1))
        found = _successes(env, expert, int(words[1] >> 1))
        for one in found[: episodes - done]:
            one.write(episode_path(folder, done), told, **{_BATCH: np.array(batch)})
            done += 1
        batch += 1


def _recorded(folder: Path, about: Mapping[str, object]) -> tuple[int, int]:
    """Number of the batch to go on with, and of the episodes before it: the last batch may not be whole."""
    batches: list[int] = []
    while (arrays := read_arrays(episode_path(folder, len(batches)), about, Episode.work, (_BATCH,))) is not None:
        batches.append(int(arrays[_BATCH]))
    return (batches[-1], batches.index(batches[-1])) if batches else (0, 0)


def _successes(env: VecEnv, expert: Acts, seed: int) -> list[Episode]:
    """Episodes with success among one of each world, in the order of the worlds."""
    state: Any = None

    def act(seen: Any, begins: np.ndarray) -> np.ndarray:
        nonlocal state
        actions, state = expert.predict(seen, state=state, episode_start=begins, deterministic=True)
        return actions

    return [
        Episode(one.images, one.pusher, one.actions)
        for one in record_episodes(env, act, seed)
        if result_of(one.info, None, len(one.actions), {}).success
    ]
