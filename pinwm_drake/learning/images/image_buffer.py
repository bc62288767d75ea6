# SPDX-License-Identifier: MIT
"""Data that a student learns from: single images, in the order in which worlds gave them, and stacks of them."""

from dataclasses import dataclass

import numpy as np

from pinwm_drake.checkpoints import ArrayFile


@dataclass(frozen=True, eq=False)
class Chunk(ArrayFile):
    """Observations of W worlds in T actions, one after another: row t W + w is world w's at action t.

    Attributes:
        image: (T W, height, width, 3) uint8, RGB: the last image, or a part of it.
        start: (T W,) bool, true where an episode begins; the first W do.
        pusher: (T W, pusher_size) float32, along the task's axes across the pusher's box, -1 to 1.
        state: (T W, state_size) float32, as `StateActor` takes it.
        goal: (T W, goal_size) float32, goals of the episodes.
        corner: (T W, 2) int16 px, first pixel of the part of the image; zeros where it is whole.
    """

    work, wanted = "distil", "the images beside a checkpoint; start anew"

    image: np.ndarray
    start: np.ndarray
    pusher: np.ndarray
    state: np.ndarray
    goal: np.ndarray
    corner: np.ndarray


class Frames:
    """Chunks of W worlds, from which batches are drawn; the oldest chunk goes when there are more than fit."""

    def __init__(self, worlds: int, frames: int, most: int) -> None:
        """Begins without a chunk.

        Args:
            worlds: Number of worlds, W.
            frames: Number of images in a stack, k.
            most: Largest number of images that are kept; the newest chunk always is, whatever its size.
        """
        self._worlds, self._frames, self._most = worlds, frames, most
        self._chunks: list[Chunk] = []
        self._ends = np.zeros(0, int)

    def __len__(self) -> int:
        return int(self._ends[-1]) if len(self._ends) else 0

    def add(self, chunk: Chunk) -> None:
        """Add a chunk, and drop the oldest ones where there are more images than fit."""
        self._chunks.append(chunk)
        while len(self._chunks) > 1 and sum(len(one.start) for one in self._chunks) > self._most:
            self._chunks.pop(0)
        self._ends = np.cumsum([len(one.start) for one in self._chunks])

    def draw(self, size: int, generator: np.random.Generator) -> tuple[np.ndarray, ...]:
        """Draws a batch of stacks, evenly and with repetition.

        Args:
            size: Number of stacks, B.
            generator: Source of randomness.

        Returns:
            Images (B, height, width, 3 k) uint8, the oldest first; pusher (B, pusher_size), state (B, state_size)
            and goal (B, goal_size), float32; corners (B, k, 2) int16 of the images.
        """
        rows = np.sort(generator.integers(len(self), size=size))
        parts = np.split(rows, np.searchsorted(rows, self._ends[:-1]))
        begins = [0, *self._ends[:-1]]
        batches = [
            self._stacks(chunk, part - begin) for chunk, part, begin in zip(self._chunks, parts, begins, strict=True)
        ]
        return tuple(np.concatenate(one) for one in zip(*batches, strict=True))

    def _stacks(self, chunk: Chunk, rows: np.ndarray) -> tuple[np.ndarray, ...]:
        """Stacks of images, pusher, state, goal and corners of some rows (b,) of a chunk; see `draw`."""
        stack = [rows]
        for _ in range(self._frames - 1):
            stack.insert(0, np.where(chunk.start[stack[0]], stack[0], stack[0] - self._worlds))
        images = np.concatenate([chunk.image[one] for one in stack], axis=3)
        corners = np.stack([chunk.corner[one] for one in stack], axis=1)
        return images, chunk.pusher[rows], chunk.state[rows], chunk.goal[rows], corners
