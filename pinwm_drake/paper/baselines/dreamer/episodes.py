# SPDX-License-Identifier: MIT
"""Task-agnostic episodes: their collection by random pushes, and sequences of them that the world model learns from."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from stable_baselines3.common.vec_env import VecEnv
from torch import Tensor

from pinwm_drake.errors import ParameterError, require
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
    """Return the function from a seed to random pushes in W worlds, for `collect`; see `RandomPushes`."""
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


_MOST = 10.0  # largest reward, in standard deviations: a bonus on success is a hundred, and its error all that counts


class Batch(NamedTuple):
    """Sequences of B times L steps; what is of an action stands beside what came of it.

    Attributes:
        image: (B, L, height, width, 3) uint8, RGB.
        pusher: (B, L, n) float32.
        action: (B, L, n) float32, actions that led to each step; zeros where an episode begins.
        reward: (B, L) float32, rewards of these actions, in standard deviations of all.
        terminal: (B, L) bool, true where the episode ended with success.
        first: (B, L) bool, true in the first step of an episode, and of a sequence.
    """

    image: Tensor
    pusher: Tensor
    action: Tensor
    reward: Tensor
    terminal: Tensor
    first: Tensor

    def to(self, device: torch.device | str) -> "Batch":
        """Return the sequences on a device."""
        return Batch(*(part.to(device) for part in self))


class Replay:
    """All steps of some episodes, one after another, from which sequences are drawn.

    A sequence may go on from the end of an episode to the beginning of the next, as in the paper's code.

    Attributes:
        reward_scale: Standard deviation of the rewards, terminal ones left out, which is the unit of `Batch.reward`.
    """

    def __init__(self, episodes: Sequence[Episode]) -> None:
        """Join the episodes.

        Raises:
            ParameterError: There are none, or their images or actions differ in size.
        """
        shapes = {(one.images.shape[1:], one.actions.shape[1]) for one in episodes}
        if len(shapes) != 1:
            raise ParameterError(f"episodes: got {len(shapes)} sizes of images and actions; allowed: 1")
        n = episodes[0].actions.shape[1]
        self._image = np.concatenate([one.images for one in episodes])
        self._pusher = np.concatenate([one.pusher for one in episodes])
        self._action = np.concatenate([np.concatenate([np.zeros((1, n)), one.actions]) for one in episodes])
        reward = np.concatenate([np.append(0.0, one.rewards) for one in episodes])
        self._first, self._terminal = np.zeros(len(reward), bool), np.zeros(len(reward), bool)
        ends = np.cumsum([len(one) + 1 for one in episodes])
        self._first[np.append(0, ends[:-1])] = True
        self._terminal[ends - 1] = [bool(one.terminated) for one in episodes]
        usual = reward[~self._first & ~self._terminal]
        self.reward_scale = (float(usual.std()) if len(usual) else 0.0) or 1.0
        self._reward = np.clip(reward / self.reward_scale, -_MOST, _MOST)

    def __len__(self) -> int:
        return len(self._first)

    @property
    def image_size(self) -> int:
        """Side of the images [px]."""
        return self._image.shape[1]

    @property
    def action_size(self) -> int:
        """Components of an action, n."""
        return self._action.shape[1]

    def draw(self, number: int, length: int, generator: np.random.Generator) -> Batch:
        """Sequences that begin anywhere, alike likely.

        Args:
            number: Number of sequences, B.
            length: Number of steps of each, L, at most all.
            generator: Generator of the draw.

        Raises:
            ParameterError: There are fewer steps than that.
        """
        if length > len(self):
            raise ParameterError(
                f"length: got {length}; allowed: up to {len(self)}, the number of steps in all episodes"
            )
        rows = generator.integers(len(self) - length + 1, size=(number, 1)) + np.arange(length)
        first = self._first[rows]
        first[:, 0] = True
        action = np.where(first[..., None], 0.0, self._action[rows])
        return Batch(
            torch.from_numpy(self._image[rows]),
            torch.from_numpy(self._pusher[rows]).float(),
            torch.from_numpy(action).float(),
            torch.from_numpy(self._reward[rows]).float(),
            torch.from_numpy(self._terminal[rows]),
            torch.from_numpy(first),
        )
