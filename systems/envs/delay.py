# SPDX-License-Identifier: MIT
"""Latency and lag of a robot and its network: actions take effect later, and velocities change gradually."""

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

    With a lag, the velocity follows what is due by a first-order lag, whose time constant is drawn for each episode as
    well; the translation of a part is that of its mean velocity. With a largest acceleration instead, the velocity
    comes evenly nearer to what is due in each part.

    Args:
        latency: s, least and largest one; drawn evenly.
        horizon: s, duration of an action.
        num_worlds: Number of worlds, W.
        task: The task, which says what an action is.
        parts: Number of parts of a horizon, 1 or more.
        lag: s, least and largest time constant; drawn evenly.
        acceleration: m/s^2, largest one of the pusher; infinite for none.
        max_translation: m, translation of the longest action.

    Raises:
        ParameterError: A latency or a lag is not finite or less than 0, or the least is more than the largest; an
            acceleration is 0 or less, or there is a lag as well.
    """

    def __init__(
        self,
        latency: tuple[float, float],
        horizon: float,
        num_worlds: int,
        task: Task,
        parts: int = 1,
        lag: tuple[float, float] = (0.0, 0.0),
        acceleration: float = math.inf,
        max_translation: float = 1.0,
    ) -> None:
        for name, (low, high) in {"latency": latency, "lag": lag}.items():
            require(name, f"{low} to {high} s", 0.0 <= low <= high < math.inf, "0 or more, finite, the least first")
        require("acceleration", acceleration, acceleration > 0.0, "more than 0")
        self._ranges, self._limited = np.array([latency, lag]) / horizon, math.isfinite(acceleration)
        require("lag", f"{lag} s with a largest acceleration", not (any(lag) and self._limited), "one of the two")
        # In a part, in velocities of the longest action.
        self._most_change = acceleration * horizon**2 / max_translation / parts
        self._latency, self._lag = np.zeros((2, num_worlds))  # in horizons
        newest = 2 + math.floor(self._ranges[0, 1])
        self._past = np.zeros((newest, num_worlds, task.action_size))  # the newest first
        self._velocity = np.zeros((num_worlds, task.action_size))  # at the end of the last action
        self._task, self._parts = task, parts

    @property
    def depth(self) -> int:
        """Number of past actions on which it mostly depends what the pusher does next; 0 where none is late."""
        return len(self._past) - 1 if self._late else 0

    @property
    def _late(self) -> bool:
        return self._limited or bool(self._ranges.any())

    def begin(self, world: int, generator: np.random.Generator) -> None:
        """Begins an episode in a world, whose generator draws latency and lag where there are ranges of them."""
        for drawn, (low, high) in zip((self._latency, self._lag), self._ranges, strict=True):
            drawn[world] = generator.uniform(low, high) if high > low else low
        self._past[:, world] = self._velocity[world] = 0.0

    def rest(self) -> None:
        """Forget the past actions of all worlds: their pushers have rested."""
        self._past[:] = self._velocity[:] = 0.0

    def recall(self, world: int, past: np.ndarray) -> None:
        """Take actions (depth, n) in [-1, 1]^n, the newest first, as those that were asked for in a world.

        The pusher has the velocity of the one that takes effect at the end of the last horizon.
        """
        if self._late:
            self._past[: self.depth, world] = past
            self._velocity[world] = self._past[int(self._latency[world]), world]

    def __call__(self, actions: np.ndarray) -> np.ndarray:
        """Actions (parts, W, n) that take effect, one after another, while those given (W, n) are asked for."""
        if not self._late:
            return actions[None]
        asked = self._task.translation(actions, 1.0)[:, self._task.axis_indices]
        self._past = np.concatenate([asked[None], self._past[:-1]])
        whole = np.floor(self._latency).astype(int)
        worlds, number = np.arange(len(whole)), np.arange(self._parts)[:, None]
        share = np.clip((self._latency - whole) * self._parts - number, 0.0, 1.0)[..., None]
        due = np.asarray((1.0 - share) * self._past[whole, worlds] + share * self._past[whole + 1, worlds])
        if self._limited:
            for part in due:
                change = part - self._velocity
                taken = np.linalg.norm(change, axis=1, keepdims=True) / self._most_change  # parts that it takes
                step = change / np.maximum(taken, 1.0)
                part += step - change - 0.5 * step * np.minimum(taken, 1.0)  # the mean over the part
                self._velocity = self._velocity + step
            return due
        lags = np.maximum(self._lag * self._parts, 1e-15)[:, None]  # in parts
        kept = np.exp(-1.0 / lags)
        for part in due:
            change = self._velocity - part
            self._velocity = part + kept * change
            part += lags * (1.0 - kept) * change  # the mean over the part
        return due

    def get_state(self) -> dict[str, np.ndarray]:
        """Latencies, lags, past actions and velocities by name, for `set_state`; nothing without latency and lag."""
        arrays = {"latency": self._latency, "lag": self._lag, "past": self._past, "velocity": self._velocity}
        return {name: values.copy() for name, values in arrays.items()} if self._late else {}

    def set_state(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Restores the arrays of `get_state`."""
        if self._late:
            self._latency, self._past = arrays["latency"].copy(), arrays["past"].copy()
            self._lag, self._velocity = arrays["lag"].copy(), arrays["velocity"].copy()
