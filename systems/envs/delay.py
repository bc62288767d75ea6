# SPDX-License-Identifier: MIT
"""The latency of a robot and its network: actions that take effect later than they are asked for."""

import math
from collections.abc import Mapping

import numpy as np

from pinwm_drake.errors import require
from pinwm_drake.tasks.task import Task


class Delay:
    """Delay of the actions of W worlds, drawn for each episode.

    An action asks for a constant velocity during a horizon. With a latency of n + f horizons, what happens during the
    first share f of a horizon is the action n + 1 before, then the one n before. A horizon has equal parts; the part
    in which the one ends and the other begins has a translation of both. Before an episode's first action the pusher
    rests.

    Args:
        latency: s, least and largest one; drawn evenly.
        horizon: s, duration of an action.
        num_worlds: Number of worlds, W.
        task: The task, which says what an action is.
        parts: Number of parts of a horizon, 1 or more.

    Raises:
        ParameterError: A latency is not finite or less than 0, or the least is more than the largest.
    """

    def __init__(
        self, latency: tuple[float, float], horizon: float, num_worlds: int, task: Task, parts: int = 1
    ) -> None:
        low, high = (float(value) for value in latency)
        require("latency", f"{low} to {high} s", 0.0 <= low <= high < math.inf, "0 or more, finite, the least first")
        self._range = (low / horizon, high / horizon)
        self._latency = np.zeros(num_worlds)  # in horizons
        self._past = np.zeros((2 + math.floor(high / horizon), num_worlds, task.action_size))  # the newest first
        self._task, self._parts = task, parts

    @property
    def depth(self) -> int:
        """Number of past actions on which it may depend what the pusher does next; 0 without a latency."""
        return len(self._past) - 1 if self._range[1] else 0

    def begin(self, world: int, generator: np.random.Generator) -> None:
        """Begins an episode in a world, whose generator draws the latency where there is a range of it."""
        low, high = self._range
        self._latency[world] = generator.uniform(low, high) if high > low else low
        self._past[:, world] = 0.0

    def rest(self) -> None:
        """Forget the past actions of all worlds: their pushers have rested."""
        self._past[:] = 0.0

    def recall(self, world: int, past: np.ndarray) -> None:
        """Take actions (depth, n) in [-1, 1]^n, the newest first, as those that were asked for in a world."""
        if self._range[1]:
            self._past[: self.depth, world] = past

    def __call__(self, actions: np.ndarray) -> np.ndarray:
        """Actions (parts, W, n) that take effect, one after another, while those given (W, n) are asked for."""
        if not self._range[1]:
            return actions[None]
        asked = self._task.translation(actions, 1.0)[:, self._task.axis_indices]
        self._past = np.concatenate([asked[None], self._past[:-1]])
        whole = np.floor(self._latency).astype(int)
        worlds, number = np.arange(len(whole)), np.arange(self._parts)[:, None]
        share = np.clip((self._latency - whole) * self._parts - number, 0.0, 1.0)[..., None]
        return np.asarray((1.0 - share) * self._past[whole, worlds] + share * self._past[whole + 1, worlds])

    def get_state(self) -> dict[str, np.ndarray]:
        """Latencies and past actions by name, for `set_state`; nothing where there is no latency."""
        return {"latency": self._latency.copy(), "past": self._past.copy()} if self._range[1] else {}

    def set_state(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Restores the arrays of `get_state`."""
        if self._range[1]:
            self._latency, self._past = arrays["latency"].copy(), arrays["past"].copy()
