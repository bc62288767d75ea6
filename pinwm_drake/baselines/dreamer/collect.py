"""Collection of task-agnostic episodes: random pushes toward the object, in many worlds at once."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from stable_baselines3.common.vec_env import VecEnv

from pinwm_drake.baselines.dreamer.replay import Episode, episode_file
from pinwm_drake.errors import require
from pinwm_drake.files import prepare_folder
from pinwm_drake.learning.spec import PolicySpec
from pinwm_drake.learning.world_evaluation import usual_starts

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
        """Begins without a motion.

        Args:
            spec: Specification of a policy, which knows task and object.
            worlds: Number of worlds, W.
            generator: Generator of the motions.
        """
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


def collect(
    env: VecEnv,
    explore: Explore,
    folder: Path,
    episodes: int,
    *,
    seed: int,
    about: Mapping[str, object] | None = None,
    resume: bool = False,
) -> list[Episode]:
    """Episodes of a policy that explores, each written to a file as it ends.

    The number of episodes of each world is settled beforehand, as in `evaluate_worlds`: those that end first would be
    the short ones. All begin where the scene says.

    Args:
        env: Worlds with observation "rgb_state": `image`, whose last three channels are kept, `pusher` and `state`.
        explore: Function from the worlds' observation to their actions (W, n).
        folder: Folder of the episodes; made if need be.
        episodes: Number of episodes, 1 or more.
        seed: Seed of the first world; world k has `seed + k`.
        about: What the episodes depend on, as JSON takes it.
        resume: Flag: where all files are there, they are read, and nothing is collected.

    Returns:
        The episodes, those of the first world first.

    Raises:
        InputError: A file cannot be read or written, or is of another collection.
        ParameterError: The number is out of range.
    """
    require("episodes", episodes, episodes >= 1, "1 or more")
    prepare_folder(folder)
    W = env.num_envs
    wanted = [(episodes + W - 1 - world) // W for world in range(W)]
    files = [episode_file(folder, number) for number in range(episodes)]
    if not resume or not all(file.exists() for file in files):
        own = np.split(np.array(files, object), np.cumsum(wanted)[:-1])
        with usual_starts(env):
            env.seed(seed)
            _run(env, explore, wanted, own, about)
    return [Episode.read(file, about) for file in files]


def _run(
    env: VecEnv,
    explore: Explore,
    wanted: list[int],
    files: list[np.ndarray],
    about: Mapping[str, object] | None,
) -> None:
    """Acts in the worlds until each has as many episodes as wanted, and writes them to files of each world's own."""
    seen: Any = env.reset()
    done = [0] * env.num_envs
    steps: list[list[tuple[np.ndarray, ...]]] = [[] for _ in done]
    while any(k < most for k, most in zip(done, wanted, strict=True)):
        actions = explore(seen)
        found: Any = env.step(actions)
        for world, (k, most) in enumerate(zip(done, wanted, strict=True)):
            if k < most:
                image, pusher = seen["image"][world, ..., -3:], seen["pusher"][world]
                steps[world].append((image, pusher, actions[world], found[1][world]))
        seen, ends, infos = found[0], found[2], found[3]
        for world in np.flatnonzero(ends).tolist():
            if done[world] < wanted[world]:
                _joined(steps[world], infos[world]).write(files[world][done[world]], about)
                done[world] += 1
            steps[world] = []


def _joined(steps: list[tuple[np.ndarray, ...]], info: dict[str, Any]) -> Episode:
    """Episode of its steps and the info at its end."""
    images, pusher, actions, rewards = (np.stack(part) for part in zip(*steps, strict=True))
    last = info["terminal_observation"]
    return Episode(
        np.concatenate([images, last["image"][None, ..., -3:]]),
        np.concatenate([pusher, last["pusher"][None]]).astype(np.float32),
        actions.astype(np.float32),
        rewards.astype(np.float32),
        np.array(not info.get("TimeLimit.truncated", False)),
    )
