# SPDX-License-Identifier: MIT
"""Point mass in a picture, a problem of known answer for methods that learn from images.

A dark square slides on white; an action pushes it, and it coasts on. It is to come within 0.15 of the middle of a
picture that spans -1 to 1, in 25 actions. One image does not tell how fast it is.
"""

from typing import Any

import numpy as np

from benchmarks.scenes.small_worlds import MakeSmallWorlds, SmallWorlds

REACH = 0.15  # largest distance of a success
STEPS = 25  # actions of an episode at most
_KEPT, _PUSH = 0.7, 0.1  # share of the velocity that stays, and velocity that an action adds


class PointMass(SmallWorlds):
    """W points; `pusher` is zero, and `state` has place and velocity, then zeros."""

    changing = ("place", "velocity")

    def __init__(self, num_envs: int = 16, size: int = 64) -> None:
        super().__init__(num_envs, size, 11, STEPS)
        self.place, self.velocity = np.zeros((num_envs, 2)), np.zeros((num_envs, 2))

    def begin(self, world: int, generator: np.random.Generator) -> None:
        """Draws a place, at rest."""
        place = np.zeros(2)
        while np.linalg.norm(place) < 2.0 * REACH:
            place = generator.uniform(-0.9, 0.9, 2)
        self.place[world], self.velocity[world] = place, 0.0

    def move(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Goes on by actions in [-1, 1]^2; the reward is how much nearer the middle is, and 1 more on success."""
        before = np.linalg.norm(self.place, axis=1)
        self.velocity = _KEPT * self.velocity + _PUSH * np.clip(actions, -1.0, 1.0)
        moved = np.clip(self.place + self.velocity, -1.0, 1.0)
        self.place, self.velocity = moved, moved - self.place
        distance = np.linalg.norm(self.place, axis=1)
        success = distance < REACH
        return before - distance + success, distance, success, np.zeros(self.num_envs, bool)

    def see(self) -> dict[str, np.ndarray]:
        """Observation with the square drawn to a share of a pixel."""
        centres = (np.arange(self.size) + 0.5) / self.size * 2.0 - 1.0
        half, pixel = 0.2, 2.0 / self.size
        # Share of each pixel's row and column that the square covers.
        cover = np.clip((half - np.abs(centres - self.place[..., None])) / pixel + 0.5, 0.0, 1.0)
        dark = cover[:, 1, :, None] * cover[:, 0, None, :]
        image = np.round(255.0 * (1.0 - dark[..., None] * np.array([0.2, 0.9, 0.9]))).astype(np.uint8)
        state = np.zeros((self.num_envs, 11), np.float32)
        state[:, :2], state[:, 2:4] = self.place, self.velocity
        return {"image": image, "pusher": np.zeros((self.num_envs, 2), np.float32), "state": state}


class PointMassWorlds(MakeSmallWorlds):
    """Maker of points."""

    def __init__(self, num_envs: int = 16, size: int = 64) -> None:
        super().__init__({"scene": "point mass", "size": size}, 0.02)
        self._num_envs, self._size = num_envs, size

    def worlds(self, observation: str) -> PointMass:
        """Return the worlds, whatever observation is asked for."""
        return PointMass(self._num_envs, self._size)


class Wandering:
    """Random actions that stay as they are for some steps, so that the point gets about."""

    def __init__(self, num_envs: int, seed: int) -> None:
        self._generator = np.random.default_rng(seed)
        self._actions, self._left = np.zeros((num_envs, 2), np.float32), np.zeros(num_envs, int)

    def __call__(self, seen: Any) -> np.ndarray:
        """Actions (W, 2) in [-1, 1]; what is seen does not matter."""
        new = self._left <= 0
        self._actions[new] = self._generator.uniform(-1.0, 1.0, (int(new.sum()), 2))
        self._left[new] = self._generator.integers(1, 9, int(new.sum()))
        self._left -= 1
        return self._actions.copy()

    def predict(
        self, observation: Any, state: None = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[np.ndarray, None]:
        """Actions with the signature of SB3's `predict`."""
        return self(observation), None


class Homing:
    """Answer to the problem, which knows place and velocity: straight to the middle at full speed."""

    def predict(
        self, observation: Any, state: None = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[np.ndarray, None]:
        """Actions (W, 2) with the signature of SB3's `predict`."""
        place, velocity = observation["state"][:, :2], observation["state"][:, 2:4]
        return np.clip(-(place + _KEPT * velocity) / _PUSH, -1.0, 1.0), None
