"""Collection of task-agnostic episodes: random pushes toward the object, in many worlds at once."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from stable_baselines3.common.vec_env import VecEnv

from pinwm_drake.errors import require
from pinwm_drake.files import prepare_folder
from pinwm_drake.learning.rounds import OnRound
from pinwm_drake.learning.spec import PolicySpec
from pinwm_drake.paper.baselines.recording import Act, Episode, episode_file, record_batch

Explore = Callable[[Any], np.ndarray]
_SHORTEST, _LONGEST = 3, 12  # actions of one push
_AWAY = 0.3  # share of the motions that head anywhere, so that pushes come from all sides
_SLOWEST = 0.3  # share of the longest translation
_NOISE = 0.15  # standard deviation of what is added to each action
_HALF = 0.05  # m, half the width of an object whose size is not known


class RandomPushes:
    """Motions of the pusher in W worlds, each some actions long: most toward a point of the object and on through it.

    Neither goal nor reward tells them where to.
    """

    def __init__(self, spec: PolicySpec, worlds: int, generator: np.random.Generator) -> None:
        self._task, self._generator = spec.task, generator
        self._half = _HALF if spec.scene is None else 0.5 * max(spec.scene.object.size)
        self._left = np.zeros(worlds, int)
        self._motion = np.zeros((worlds, spec.task.action_size))

    def __call__(self, seen: Any) -> np.ndarray:
        """Actions (W, n) in [-1, 1] for observations with `state`."""
        begin = self._left <= 0
        if begin.any():
            self._motion[begin] = self._drawn(seen["state"][begin])
            self._left[begin] = self._generator.integers(_SHORTEST, _LONGEST + 1, size=int(begin.sum()))
        self._left -= 1
        noise = _NOISE * self._generator.standard_normal(self._motion.shape)
        return np.clip(self._motion + noise, -1.0, 1.0).astype(np.float32)

    def _drawn(self, state: np.ndarray) -> np.ndarray:
        """Motions (m, n) of worlds in states (m, state_size)."""
        axes, draw = self._task.axis_indices, self._generator
        object_state, p_WP = self._task.object_state(state)
        way = (object_state[:, 4:7] - p_WP)[:, axes]
        way = way + draw.uniform(-self._half, self._half, way.shape)
        anywhere = draw.random(len(way)) < _AWAY
        way[anywhere] = draw.standard_normal((int(anywhere.sum()), len(axes)))
        way /= np.maximum(np.linalg.norm(way, axis=1, keepdims=True), 1e-9)
        return way * draw.uniform(_SLOWEST, 1.0, (len(way), 1))


def random_pushes(spec: PolicySpec, worlds: int) -> Callable[[int], Explore]:
    """Function from a seed to random pushes in W worlds, for `collect`; see `RandomPushes`."""
    return lambda seed: RandomPushes(spec, worlds, np.random.default_rng(seed))


def collect(
    env: VecEnv,
    make_explore: Callable[[int], Explore],
    folder: Path,
    episodes: int,
    *,
    seed: int,
    about: Mapping[str, object] | None = None,
    on_batch: OnRound | None = None,
) -> list[Episode]:
    """Episodes of a policy that explores, each a file `00000.npz` and so on.

    The worlds run batches of one episode each, all of which follow from the seed and the batch's number: those that end
    first would be the short ones. A collection that was stopped goes on with the same episodes, and so does one that is
    asked for more.

    Args:
        env: Worlds with observation "rgb_state": `image`, whose last three channels are kept, `pusher` and `state`.
        make_explore: Gives, from a batch's seed, the function from the worlds' observation to their actions (W, n).
        folder: Folder of the episodes; made if need be.
        episodes: Number of episodes, 1 or more.
        seed: Seed of the collection, 0 or more.
        about: What the episodes depend on, as JSON takes it: a folder with episodes of other ones is refused.
        on_batch: Called with a seed before a batch, to draw its domains.

    Returns:
        The episodes, batch after batch, in the order of the worlds.

    Raises:
        InputError: A file cannot be read or written, or is of another collection.
        ParameterError: The number is out of range.
    """

    def acting(seed: int) -> Act:
        explore = make_explore(seed)
        return lambda seen, begins: explore(seen)

    require("episodes", episodes, episodes >= 1, "1 or more")
    told = {"seed": seed, "worlds": env.num_envs, **(about or {})}
    files = [episode_file(prepare_folder(folder), number) for number in range(episodes)]
    for file in files:
        if file.exists():  # before any is written: it may be of another collection
            Episode.read(file, told)
    for number, begin in enumerate(range(0, episodes, env.num_envs)):
        batch = files[begin : begin + env.num_envs]
        if all(file.exists() for file in batch):
            continue
        found = record_batch(env, acting, number, seed=seed, on_batch=on_batch)
        for file, (one, _) in zip(batch, found, strict=False):
            one.write(file, told)
    return [Episode.read(file, told) for file in files]
