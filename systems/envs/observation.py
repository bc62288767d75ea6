# SPDX-License-Identifier: MIT
"""Observations of policies: numbers of the state, or masked images and the pusher's own position."""

from collections.abc import Mapping
from typing import Any, Literal

import numpy as np
from gymnasium import spaces

from pinwm_drake.errors import require
from pinwm_drake.rendering.kernels.stack import roll_in
from pinwm_drake.systems.scenario.setup import Setup
from pinwm_drake.tasks.history import begun, history_size
from pinwm_drake.threads import available, share

Kind = Literal["state", "rgb", "rgb_state"]
_ENTRIES = {"state": ("state",), "rgb": ("image", "pusher"), "rgb_state": ("image", "pusher", "state")}
KINDS = tuple(_ENTRIES)
_PAST = "past."

Observation = Any  # an array, or a dict of arrays; W worlds lead


class Observer:
    """Observations of W worlds.

    `state`, float32 (task.state_size,): `Task.state`. `rgb`, a dict: `image`, uint8 (height, width, 3 k): the last k
    images of the object on white, the oldest first; and `pusher`, float32 (task.action_size,) in [-1, 1]: its position
    along the task's axes across the box that it may be in. `rgb_state` has all three. Where episodes draw their goals,
    `goal`, float32 (task.goal_size,), is beside these, and `state` is a dict of state and goal too.

    With a history of h actions, `state` and `pusher` go on with what was before, as `tasks.history` has it: state or
    position before each of the last h actions, and the action, as it was asked for, in [-1, 1] along the task's axes.

    Args:
        setup: The scene: task, camera, pusher's box and number of worlds.
        kind: "state", "rgb" or "rgb_state".
        frames: Number k of the last images that are seen, 1 or more.
        history: Number h of the last actions that are seen, 0 or more.

    Attributes:
        space: Observation space of one world.
        kind, history: As given.

    Raises:
        ParameterError: There is no such kind, or no frame; or a history beside goals that episodes draw, from
            which the state is told, and the actions are not.
    """

    def __init__(self, setup: Setup, kind: Kind, frames: int = 1, history: int = 0) -> None:
        require("observation", repr(kind), kind in KINDS, ", ".join(KINDS))
        require("frames", frames, frames >= 1, "1 or more")
        require("history", f"{history} where episodes draw their goals", not history or not setup.task.goal_size, "0")
        self.kind, self.history, self._task = kind, history, setup.task
        pusher, self._axes = setup.scenario.pusher, setup.task.axis_indices
        low, high = np.array(pusher.low)[self._axes], np.array(pusher.high)[self._axes]
        self._middle, self._half = 0.5 * (low + high), 0.5 * (high - low)
        height, width = setup.camera.height, setup.camera.width
        self._images = np.zeros((setup.scenario.num_worlds, height, width, 3 * frames), np.uint8)
        bound = self._task.state_bound
        n, worlds = self._task.action_size, setup.scenario.num_worlds
        sizes = {"pusher": n, "state": self._task.state_size}
        shapes = {name: (history_size(size, n, history),) for name, size in sizes.items()}
        every: dict[str, spaces.Space] = {
            "image": spaces.Box(0, 255, self._images.shape[1:], np.uint8),
            "pusher": spaces.Box(-1.0, 1.0, shapes["pusher"], np.float32),
            "state": spaces.Box(-bound, bound, shapes["state"], np.float32),
        }
        seen = {name: every[name] for name in _ENTRIES[kind]}
        if self._task.goal_size:
            seen["goal"] = spaces.Box(-np.inf, np.inf, (self._task.goal_size,), np.float32)
        self.space = every["state"] if list(seen) == ["state"] else spaces.Dict(seen)
        self._past = {
            name: np.zeros((worlds, history, size + n), np.float32)
            for name, size in sizes.items()
            if history and name in seen
        }

    @property
    def needs_images(self) -> bool:
        """Flag: images are seen, so that `see` is to be called."""
        return self.kind != "state"

    def see(self, images: np.ndarray) -> None:
        """Take images (W, height, width, 4) uint8 RGBA of all worlds as the last ones."""
        share(roll_in, (self._images, images), len(images), available())

    def begin(self, worlds: np.ndarray, images: np.ndarray) -> None:
        """Take images (m, height, width, 4) uint8 RGBA as all that worlds with indices (m,) have seen."""
        self._images[worlds] = np.tile(images[..., :3], self._images.shape[3] // 3)

    def remember(self, object_state: np.ndarray, p_WP: np.ndarray, goal: np.ndarray, actions: np.ndarray) -> None:
        """Take actions (W, n) in [-1, 1]^n, and the states before them, as for `observe`, as the last ones."""
        if not self._past:
            return
        now, action = self._now(object_state, p_WP, goal), self._task.translation(actions, 1.0)[:, self._axes]
        for name, past in self._past.items():
            past[:, 1:] = past[:, :-1].copy()
            past[:, 0] = np.concatenate([now[name], action], axis=1)

    def forget(self, object_state: np.ndarray, p_WP: np.ndarray, goal: np.ndarray, worlds: np.ndarray) -> None:
        """Take the states, as for `observe`, of worlds with indices (m,) as all that was there, without an action."""
        if not self._past:
            return
        now = self._now(object_state[worlds], p_WP[worlds], goal[worlds])
        for name, past in self._past.items():
            past[worlds] = begun(now[name], self._task.action_size, 1)[:, None, now[name].shape[1] :]

    def recall(self, world: int, actions: np.ndarray) -> None:
        """Take actions (m, n) in [-1, 1]^n, the newest first, m of `history` or more, as a world's last ones."""
        for past in self._past.values():
            past[world, :, -self._task.action_size :] = actions[: self.history]

    def get_state(self) -> dict[str, np.ndarray]:
        """Images and history that the worlds have seen last, by name, for `set_state`."""
        past = {f"{_PAST}{name}": values.copy() for name, values in self._past.items()}
        return past | ({"images": self._images.copy()} if self.needs_images else {})

    def set_state(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Restores the arrays of `get_state`."""
        if self.needs_images:
            self._images = arrays["images"].copy()
        self._past = {name: arrays[f"{_PAST}{name}"].copy() for name in self._past}

    def observe(
        self,
        object_state: np.ndarray,
        p_WP: np.ndarray,
        worlds: np.ndarray | slice = np.s_[:],
        goal: np.ndarray | None = None,
    ) -> Observation:
        """Observations, in arrays of their own.

        Args:
            object_state: (W, 13), as for `Task.measure`, of the world.
            p_WP: (W, 3) m, world: position of the pusher.
            worlds: Indices of the worlds that are observed, or a slice of them.
            goal: (W, task.goal_size) goals of the episodes; None where episodes draw none.
        """
        object_state, p_WP = object_state[worlds], p_WP[worlds]
        goal = np.zeros((len(p_WP), 0)) if goal is None else goal[worlds]
        seen = {"image": self._images[worlds].copy()} if self.needs_images else {}
        seen |= self._now(object_state, p_WP, goal)
        for name, past in self._past.items():
            seen[name] = np.concatenate([seen[name], past[worlds].reshape(len(p_WP), -1)], axis=1)
        if self._task.goal_size:
            seen["goal"] = goal.astype(np.float32)
        return seen if isinstance(self.space, spaces.Dict) else seen["state"]

    def _now(self, object_state: np.ndarray, p_WP: np.ndarray, goal: np.ndarray) -> dict[str, np.ndarray]:
        """Pusher and state, where they are seen, of worlds (m, ...), without a history; see `observe`."""
        seen: dict[str, np.ndarray] = {}
        if self.needs_images:
            pusher = (p_WP[:, self._axes] - self._middle) / self._half
            seen["pusher"] = np.clip(pusher, -1.0, 1.0).astype(np.float32)
        if self.kind != "rgb":
            seen["state"] = self._task.state(*self._task.from_goal(object_state, p_WP, goal))
        return seen
