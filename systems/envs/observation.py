"""What a policy of the push task sees: numbers of the state, or masked images and the pusher's own position."""

from collections.abc import Mapping
from typing import Any, Literal

import cv2
import numpy as np
from gymnasium import spaces

from pinwm_drake.errors import ParameterError
from pinwm_drake.learning.spec import LENGTH
from pinwm_drake.systems.scenario.setup import Setup
from pinwm_drake.tasks.push import PushTask, turn_from

Kind = Literal["state", "rgb", "rgb_state"]
KINDS = ("state", "rgb", "rgb_state")
STATE_SIZE = 11
SPEED, TURN = 0.3, 3.0  # m/s, rad/s: what stands for 1
_BOUND = 20.0  # of `state`; what lies beyond is cut off
Observation = Any  # an array, or a dict of arrays; W worlds lead


class PushObserver:
    """Observations of W worlds.

    `state`, float32 (11), each within [-20, 20], in the frame of the goal: x, y of the goal, axes turned by its yaw:

        0, 1    x, y of the object's origin, in 0.1 m
        2, 3    cos, sin of the object's yaw
        4, 5    its velocity, in 0.3 m/s
        6       its rate of turn about z, in 3 rad/s
        7, 8    the pusher, seen from the object's origin, axes turned with the object, in 0.1 m
        9, 10   the pusher, in 0.1 m

    `rgb`, a dict: `image`, uint8 (height, width, 3 k): the last k images of the object on white, the oldest first; and
    `pusher`, float32 (2) in [-1, 1]: its x and y across the box that it may be in. `rgb_state` has all three.

    Attributes:
        kind: "state", "rgb" or "rgb_state".
        space: Of one world.
    """

    def __init__(self, setup: Setup, task: PushTask, kind: Kind, frames: int = 1) -> None:
        """Makes the space.

        Args:
            setup: Camera, pusher's box and number of worlds.
            task: The goal.
            kind: What is seen.
            frames: k, 1 or more.

        Raises:
            ParameterError: There is no such kind, or no frame.
        """
        if kind not in KINDS:
            raise ParameterError(f"observation: got {kind!r}; allowed: {', '.join(KINDS)}")
        if frames < 1:
            raise ParameterError(f"frames: got {frames}; allowed: 1 or more")
        self.kind, self._goal = kind, np.array(task.goal)
        self._q_WO = np.array(task.q_WO)
        pusher = setup.scenario.pusher
        low, high = np.array(pusher.low[:2]), np.array(pusher.high[:2])
        self._middle, self._half = 0.5 * (low + high), 0.5 * (high - low)
        height, width = setup.camera.height, setup.camera.width
        self._images = np.zeros((setup.scenario.num_worlds, height, width, 3 * frames), np.uint8)
        state = spaces.Box(-_BOUND, _BOUND, (STATE_SIZE,), np.float32)
        seen: dict[str, spaces.Space] = {
            "image": spaces.Box(0, 255, self._images.shape[1:], np.uint8),
            "pusher": spaces.Box(-1.0, 1.0, (2,), np.float32),
        }
        if kind == "rgb_state":
            seen["state"] = state
        self.space: spaces.Space = state if kind == "state" else spaces.Dict(seen)

    @property
    def needs_images(self) -> bool:
        """Whether `see` is to be called."""
        return self.kind != "state"

    def see(self, images: np.ndarray) -> None:
        """Takes images (W, height, width, 4) as the last ones."""
        stack, rgb = self._images, _without_alpha(images)
        if stack.shape[3] == 3:
            self._images = rgb
            return
        stack[..., :-3] = stack[..., 3:].copy()
        stack[..., -3:] = rgb

    def begin(self, worlds: np.ndarray, images: np.ndarray) -> None:
        """Takes images (m, height, width, 4) as all that some worlds (m,) have seen."""
        self._images[worlds] = np.tile(images[..., :3], self._images.shape[3] // 3)

    def get_state(self) -> dict[str, np.ndarray]:
        """The images that the worlds have seen last, for `set_state`."""
        return {"images": self._images.copy()} if self.needs_images else {}

    def set_state(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Puts what `get_state` gave back."""
        if self.needs_images:
            self._images = arrays["images"].copy()

    def observe(self, object_state: np.ndarray, p_WP: np.ndarray, worlds: np.ndarray | slice = np.s_[:]) -> Observation:
        """What is seen, in arrays of its own.

        Args:
            object_state: (W, 13), as the station's port has it.
            p_WP: (W, 3) m.
            worlds: Which of them.
        """
        if self.kind == "state":
            return self.state(object_state[worlds], p_WP[worlds])
        pusher = (p_WP[worlds, :2] - self._middle) / self._half
        seen = {"image": self._images[worlds].copy(), "pusher": np.clip(pusher, -1.0, 1.0).astype(np.float32)}
        if self.kind == "rgb_state":
            seen["state"] = self.state(object_state[worlds], p_WP[worlds])
        return seen

    def state(self, object_state: np.ndarray, p_WP: np.ndarray) -> np.ndarray:
        """`state` (m, 11) of m worlds."""
        values = np.empty((len(object_state), STATE_SIZE))
        yaw = turn_from(self._q_WO, object_state[:, :4])
        turn = yaw - self._goal[2]
        p_WO = object_state[:, 4:6]
        values[:, 0:2] = _turned(p_WO - self._goal[:2], self._goal[2]) / LENGTH
        values[:, 2], values[:, 3] = np.cos(turn), np.sin(turn)
        values[:, 4:6] = _turned(object_state[:, 10:12], self._goal[2]) / SPEED
        values[:, 6] = object_state[:, 9] / TURN
        values[:, 7:9] = _turned(p_WP[:, :2] - p_WO, yaw) / LENGTH
        values[:, 9:11] = _turned(p_WP[:, :2] - self._goal[:2], self._goal[2]) / LENGTH
        return np.clip(np.nan_to_num(values), -_BOUND, _BOUND).astype(np.float32)


def _without_alpha(images: np.ndarray) -> np.ndarray:
    """(W, height, width, 3) of images with alpha; numpy takes ten times as long to copy three bytes of four."""
    W, height, width, _ = images.shape
    rows = np.ascontiguousarray(images).reshape(W * height, width, 4)
    rgb: np.ndarray = cv2.cvtColor(rows, cv2.COLOR_RGBA2RGB).reshape(W, height, width, 3)
    return rgb


def _turned(vectors: np.ndarray, yaw: np.ndarray | float) -> np.ndarray:
    """Vectors (W, 2) in axes that are turned by yaw."""
    c, s = np.cos(yaw), np.sin(yaw)
    return np.stack([c * vectors[:, 0] + s * vectors[:, 1], c * vectors[:, 1] - s * vectors[:, 0]], axis=1)
