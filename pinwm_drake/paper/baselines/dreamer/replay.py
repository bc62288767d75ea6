"""Episodes that the world model learns from, one after another, and sequences of them."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from pinwm_drake.errors import ParameterError
from pinwm_drake.paper.baselines.recording import Episode

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
        """The sequences on a device."""
        return Batch(*(part.to(device) for part in self))


class Replay:
    """All steps of some episodes, one after another, from which sequences are drawn.

    A sequence may go on from the end of an episode to the beginning of the next, as in the paper's code.

    Attributes:
        reward_scale: Standard deviation of the rewards, terminal ones left out, which is the unit of `Batch.reward`.
    """

    def __init__(self, episodes: Sequence[Episode]) -> None:
        """Joins the episodes.

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
