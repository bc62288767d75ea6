# SPDX-License-Identifier: MIT
"""The flip task: an object that lies on a floor is poked until one of its axes points up, where it is to rest."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar, Self

import numpy as np

from pinwm_drake.errors import require
from pinwm_drake.tasks.task import Positive, Progress, Reward, Task, lengths
from pinwm_drake.validation import check_fields

LENGTH, SPEED, TURN = 0.1, 1.0, 10.0  # m, m/s, rad/s: units of the state's components
NEAR = 0.1  # m, from which on the pusher counts as at the object, in the shaped reward
UPRIGHT = 0.6  # rad, from upright, from which on the rate of turn counts in it


@dataclass(frozen=True)
class FlipTask(Task):
    """Task of turning an object until an axis of its own points up, in any place and at any yaw.

    Rewards, of a step that ends at d_t [m], how far the origin is from the height that it has at the goal, and d_r
    [rad], between the axis and the world's z:

        paper    -d_t - d_r
        shaped   phi(before) - phi(after) - cost + bonus * worth on success,
                 phi = 2 d_r + 2 max(0, reach - 0.1) + 0.2 min(w, 10) max(0, 1 - d_r / 0.6)
                     with the pusher's distance `reach` [m] in space and the object's rate of turn w [rad/s],
                 worth = 1 up to `room` from the middle of the floor, 0 from twice that on, and linear between

    An object that is slapped over spins, flies or rolls off, differently in each engine and on each table, and out of
    the camera's view. One that is upright and turns rolls on its rim, for as long as an engine lets it.

    The state, float32 (18), each within [-20, 20], world axes:

        0-2     the object's origin, from the middle of the floor, its height from that at the goal, in 0.1 m
        3-5     the axis that is to point up
        6-8     an axis that tells the object's turn about it; zero for an object that is round about it
        9-11    velocity of the origin, in 1 m/s
        12-14   angular velocity, in 10 rad/s
        15-17   the pusher, from the object's origin, in 0.1 m

    Attributes:
        up: (3,) axis in the object's frame O that is to point up; of any length but zero.
        side: (3,) another axis in O, that tells the turn about `up`; zero for an object that is round about it.
        height: m, world: z of the object's origin at the goal; environments replace it by that of their scene.
        middle: (2,) m, world: x and y of the middle of the floor.
        reward: "paper" or "shaped".
        turn_tolerance: rad, largest d_r of a success.
        tolerance: m, largest d_t of a success, which tells that the object stands on the floor.
        rest_speed: m/s, speed of the origin below which the object rests.
        rest_turn: rad/s, rate of turn below which the object rests.
        cost: Cost of an action in the shaped reward.
        bonus: Bonus on success in the shaped reward.
        room: m, from the middle of the floor, within which a success has all of the bonus.

    Raises:
        ParameterError: There is no such reward, an axis or a number is out of range.
    """

    name: ClassVar[str] = "flip"
    axes: ClassVar[tuple[str, ...]] = ("x", "y", "z")
    state_size: ClassVar[int] = 18
    max_steps: ClassVar[int] = 25
    errors: ClassVar[tuple[float, ...]] = tuple(np.repeat([0.03, 0.1, 0.1, 0.25, 0.25, 0.03], 3).tolist())

    up: tuple[float, float, float] = (0.0, 0.0, -1.0)
    side: tuple[float, float, float] = (0.0, 0.0, 0.0)
    height: float = 0.0
    middle: tuple[float, float] = (0.0, 0.0)
    reward: Reward = "paper"
    turn_tolerance: Positive = 0.2
    tolerance: Positive = 0.01
    rest_speed: Positive = 0.02
    rest_turn: Positive = 0.3
    cost: float = 0.02
    bonus: float = 10.0
    room: Positive = 0.2

    def __post_init__(self) -> None:
        check_fields(self, "task.", as_given=True)
        require("task.up", self.up, any(self.up), "an axis in O, finite and not zero")
        across = not any(self.side) or float(np.linalg.norm(np.cross(self.up, self.side))) > 0.0
        require("task.side", self.side, across, "zero, or an axis in O that is not along `up`")

    @cached_property
    def _axes_O(self) -> np.ndarray:
        """Axes `up` and `side` (2, 3) in O, of unit length and at right angles; the latter zero where it is."""
        up = np.array(self.up) / np.linalg.norm(self.up)
        side = np.array(self.side) - up * (up @ self.side)
        return np.stack([up, side / max(float(np.linalg.norm(side)), 1e-300)])

    def placed(self, q_WO: Sequence[float], vertices: np.ndarray, floor_height: float) -> Self:
        """Return the task of an object on a floor, with its origin's height at the goal; see `Task.placed`."""
        return replace(self, height=float(floor_height - (np.asarray(vertices) @ self._axes_O[0]).min()))

    def moved(self, x: float, y: float) -> Self:
        """Return the task whose floor has its middle x, y [m] farther; see `Task.moved`."""
        return replace(self, middle=(self.middle[0] + x, self.middle[1] + y))

    @property
    def origin(self) -> np.ndarray:
        """Point (3,) m, world, from which the state counts: the middle of the floor, at the height of the goal."""
        return np.array([*self.middle, self.height])

    def for_training(self) -> Self:
        """Return the task with the shaped reward."""
        return replace(self, reward="shaped")

    def measure(self, object_state: np.ndarray, p_WP: np.ndarray) -> Progress:
        """Height from the goal's, angle and success of W worlds; see `Task.measure`."""
        p_WO = object_state[:, 4:7]
        distance = np.abs(p_WO[:, 2] - self.height)
        angle = np.arccos(np.clip(self._axes_W(object_state[:, :4])[:, 0, 2], -1.0, 1.0))
        reach = lengths(p_WP - p_WO)
        speed, turn = lengths(object_state[:, 10:13]), lengths(object_state[:, 7:10])
        at_rest = (speed < self.rest_speed) & (turn < self.rest_turn)
        success = (distance < self.tolerance) & (angle < self.turn_tolerance) & at_rest
        return Progress(distance, angle, reach, at_rest, success, lengths(p_WO[:, :2] - self.middle), turn)

    def worth(self, progress: Progress) -> np.ndarray:
        """Worth (W,) of successes: 1 in the room, and less farther off; see the class."""
        assert progress.astray is not None
        worth: np.ndarray = np.clip(2.0 - progress.astray / self.room, 0.0, 1.0)
        return worth

    def rewards(self, before: Progress, after: Progress) -> np.ndarray:
        """Rewards (W,) of the kind `reward`."""
        if self.reward == "paper":
            return -after.distance - after.angle
        gain: np.ndarray = (
            _potential(before) - _potential(after) - self.cost + self.bonus * after.success * self.worth(after)
        )
        return gain

    def state(self, object_state: np.ndarray, p_WP: np.ndarray) -> np.ndarray:
        """State (W, 18) float32 of W worlds, whose components the class describes; see `Task.state`."""
        p_WO, values = object_state[:, 4:7], np.empty((len(object_state), self.state_size))
        values[:, 0:3] = (p_WO - self.origin) / LENGTH
        values[:, 3:9] = self._axes_W(object_state[:, :4]).reshape(-1, 6)
        values[:, 9:12] = object_state[:, 10:13] / SPEED
        values[:, 12:15] = object_state[:, 7:10] / TURN
        values[:, 15:18] = (p_WP - p_WO) / LENGTH
        return np.clip(np.nan_to_num(values), -self.state_bound, self.state_bound).astype(np.float32)

    def object_state(self, state: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Object (W, 13) and pusher (W, 3); a round object's turn about its axis is any. See `Task.object_state`."""
        state = np.asarray(state, float)
        found = np.zeros((len(state), 13))
        found[:, :4] = [_orientation(self._axes_O, row[3:9].reshape(2, 3)) for row in state]
        found[:, 4:7] = LENGTH * state[:, 0:3] + self.origin
        found[:, 7:10], found[:, 10:13] = TURN * state[:, 12:15], SPEED * state[:, 9:12]
        return found, found[:, 4:7] + LENGTH * state[:, 15:18]

    def state_components(self) -> tuple[tuple[str, str], ...]:
        """Meaning and unit of the state's components; see `Task.state_components`."""
        length, speed, turn = f"{LENGTH:g} m", f"{SPEED:g} m/s", f"{TURN:g} rad/s"
        parts = (
            ("the object's origin, from the middle of the floor, z from its height at the goal", length),
            ("the axis that is to point up", "1"),
            ("the axis that tells the turn about it", "1"),
            ("the object's velocity", speed),
            ("the object's angular velocity", turn),
            ("the pusher, from the object's origin", length),
        )
        return tuple((f"{axis} of {words}, world", unit) for words, unit in parts for axis in "xyz")

    def to_document(self) -> dict[str, Any]:
        """Return the task as plain data, without a `middle` that is the origin of W; see `Task.to_document`."""
        document = super().to_document()
        if not any(self.middle):
            del document["middle"]
        return document

    def near_goal(self, state: np.ndarray, share: float = 1.0) -> bool:
        """Flag: the axis is within a share of the tolerance of upright, by components 3 to 5 of a state (18,)."""
        return bool(tilt(state) < share * self.turn_tolerance)

    def _axes_W(self, q_WO: np.ndarray) -> np.ndarray:
        """Axes `up` and `side` (W, 2, 3) in the world at orientations q_WO (W, 4) wxyz, of any norm but zero."""
        q = q_WO / lengths(q_WO)[:, None]
        w, v = q[:, None, :1], q[:, None, 1:]
        a = self._axes_O[None]
        twice = 2.0 * np.cross(v, a)
        turned: np.ndarray = a + w * twice + np.cross(v, twice)
        return turned


def _orientation(axes_O: np.ndarray, axes_W: np.ndarray) -> np.ndarray:
    """Orientation (4,) wxyz that turns axes (2, 3) in O to those in the world; NaN where these are none."""
    if not np.isfinite(axes_W).all() or not axes_W[0].any():
        return np.full(4, np.nan)
    frames = [_frame(*axes) for axes in (axes_O, axes_W)]
    from scipy.spatial.transform import Rotation

    return np.roll(Rotation.from_matrix(frames[1] @ frames[0].T).as_quat(), 1)


def _frame(up: np.ndarray, side: np.ndarray) -> np.ndarray:
    """Rotation matrix (3, 3) whose first column is along `up`, the second as near to `side` as that allows, or any."""
    up = up / np.linalg.norm(up)
    if not np.linalg.norm(np.cross(up, side)) > 1e-6:
        side = np.eye(3)[np.argmin(np.abs(up))]
    side = side - up * (up @ side)
    side = side / np.linalg.norm(side)
    return np.stack([up, side, np.cross(up, side)], axis=1)


def tilt(state: np.ndarray) -> float:
    """Angle [rad] between the axis of a state (18,) and the world's z; NaN where its components are."""
    x, y, z = (float(value) for value in state[3:6])
    return math.atan2(math.hypot(x, y), z)


def _potential(progress: Progress) -> np.ndarray:
    assert progress.turn is not None
    phi: np.ndarray = 2.0 * progress.angle + 2.0 * np.maximum(progress.reach - NEAR, 0.0)
    upright = np.maximum(1.0 - progress.angle / UPRIGHT, 0.0)
    return phi + 2.0 * np.minimum(progress.turn / TURN, 1.0) * upright
