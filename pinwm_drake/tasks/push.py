# SPDX-License-Identifier: MIT
"""The push task: an object is pushed to a pose on the floor, where it is to rest."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Self

import numpy as np
from pydantic import Field

from pinwm_drake.errors import require
from pinwm_drake.tasks.task import Positive, Progress, Reward, Task, lengths
from pinwm_drake.validation import check_fields

if TYPE_CHECKING:
    from pinwm_drake.spatial.poses import Pose

LENGTH, SPEED, TURN = 0.1, 0.3, 3.0  # m, m/s, rad/s: units of the state's components
_NEARER = 0.9  # share of the tolerances in training: images tell an object's place to some millimetres
_GOAL, _TURNS = "3 numbers, x [m], y [m] and yaw [rad]", "a quaternion wxyz that is finite and not zero"
_Reach = Annotated[float, Field(ge=0)]


def _words(allowed: str) -> Any:
    return Field(json_schema_extra={"allowed": allowed})


@dataclass(frozen=True)
class PushTask(Task):
    """Task of pushing an object to a fixed pose on the floor, where it is to rest.

    Rewards, of a step that ends at d_t [m] and d_r [rad]:

        paper    -d_t - d_r
        shaped   phi(before) - phi(after) - cost + bonus on success,
                 phi = 10 d_t + d_r + 2 max(0, reach - 0.1)    with the pusher's distance `reach` [m]

    The last term of phi brings the pusher to the object. Without a discount the shaped reward is a difference of
    potentials and leaves the order of policies as it is, but for the cost of time. With a discount gamma < 1 that would
    need phi(before) - gamma phi(after) (Ng, Harada and Russell, ICML 1999), which this is not: then it favours being
    near the goal by (1 - gamma) phi a step.

    The state, float32 (11), each within [-20, 20], in the frame of the goal: x, y of the goal, axes turned by its yaw:

        0, 1    x, y of the object's origin, in 0.1 m
        2, 3    cos, sin of the object's yaw
        4, 5    its velocity, in 0.3 m/s
        6       its rate of turn about z, in 3 rad/s
        7, 8    the pusher, seen from the object's origin, axes turned with the object, in 0.1 m
        9, 10   the pusher, in 0.1 m

    Attributes:
        goal: x [m], y [m], yaw [rad] of the object's frame O in the world; yaw is a turn about z after `q_WO`.
        goal_range: x [m], y [m], yaw [rad]: how far from `goal`, either way, an episode's goal is drawn. Where that is
            not zero, policies see the episode's goal (3,) beside what else they see: x [m], y [m], yaw [rad], world.
            State and reward are those of an object and a pusher that were moved along with the goal to `goal`.
        q_WO: (4,) wxyz, orientation of the object at yaw 0; environments replace it by that of their scene.
        reward: "paper" or "shaped".
        tolerance: m, largest d_t of a success.
        turn_tolerance: rad, largest d_r of a success.
        rest_speed: m/s, speed below which the object rests. Friction of 0.03 stops it within 0.05 mm from there.
        rest_turn: rad/s, rate of turn below which the object rests.
        cost: Cost of an action in the shaped reward.
        bonus: Bonus on success in the shaped reward.

    Raises:
        ParameterError: There is no such reward, the goal is not finite, or a tolerance or limit of rest is not finite
            and positive.
    """

    name: ClassVar[str] = "push"
    axes: ClassVar[tuple[str, ...]] = ("x", "y")
    state_size: ClassVar[int] = 11

    goal: Annotated[tuple[float, float, float], _words(f"{_GOAL}, finite")] = (0.0, 0.0, 0.0)
    q_WO: Annotated[tuple[float, float, float, float], _words(_TURNS)] = (1.0, 0.0, 0.0, 0.0)
    reward: Reward = "paper"
    tolerance: Positive = 0.02
    turn_tolerance: Positive = 0.2
    rest_speed: Positive = 0.005
    rest_turn: Positive = 0.05
    cost: float = 0.01
    bonus: float = 10.0
    goal_range: Annotated[tuple[_Reach, _Reach, _Reach], _words(f"{_GOAL}, 0 or more")] = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        check_fields(self, "task.", as_given=True)
        require("task.q_WO", self.q_WO, any(self.q_WO), _TURNS)

    @cached_property
    def q_WG(self) -> np.ndarray:
        """Orientation (4,) wxyz of the object at the goal, unit norm."""
        return _turned_about_z(np.array(self.q_WO) / np.linalg.norm(self.q_WO), self.goal[2])

    @property
    def goal_size(self) -> int:
        """Number of components of an episode's goal: 3, or 0 without a range of goals."""
        return 3 if any(self.goal_range) else 0

    def goal_components(self) -> tuple[tuple[str, str], ...]:
        """Meaning and unit of an episode's goal; see `Task.goal_components`."""
        words = "of the object's frame O at the goal"
        all_three = ((f"x {words}", "m"), (f"y {words}", "m"), (f"yaw {words}: a turn about z after q_WO", "rad"))
        return all_three[: self.goal_size]

    def draw_goal(self, generator: np.random.Generator) -> np.ndarray:
        """Goal (3,) of an episode: x [m], y [m], yaw [rad], drawn evenly; (0,) without a range of goals."""
        if not self.goal_size:
            return np.zeros(0)
        drawn: np.ndarray = np.array(self.goal) + generator.uniform(-1.0, 1.0, 3) * self.goal_range
        return drawn

    def with_goal(self, goal: np.ndarray) -> Self:
        """Return the task with an episode's goal (3,) alone, and no range; the same one for a goal of no components."""
        if not len(goal):
            return self
        x, y, yaw = (float(value) for value in goal)
        return replace(self, goal=(x, y, yaw), goal_range=(0.0, 0.0, 0.0))

    def from_goal(self, object_state: np.ndarray, p_WP: np.ndarray, goal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Object and pusher as seen from episodes' goals (W, 3); see `Task.from_goal`."""
        if not self.goal_size:
            return object_state, p_WP
        turn = self.goal[2] - goal[:, 2]
        moved, pusher = object_state.copy(), p_WP.copy()
        moved[:, :4] = _turned_about_z(object_state[:, :4], turn)
        moved[:, 4:6] = _turned(object_state[:, 4:6] - goal[:, :2], -turn) + self.goal[:2]
        for k in (7, 10):
            moved[:, k : k + 2] = _turned(object_state[:, k : k + 2], -turn)
        pusher[:, :2] = _turned(p_WP[:, :2] - goal[:, :2], -turn) + self.goal[:2]
        return moved, pusher

    def world_action(self, action: Any, goal: Any) -> Any:
        """Actions (B, 2) along the world's axes, of those towards the task's own goal; see `Task.world_action`."""
        from pinwm_drake.tasks.push_assembly import turned

        short = action / (action * action).sum(1, keepdim=True).sqrt().clamp(min=1.0)
        return turned(short, goal[:, 2] - self.goal[2])

    def to_document(self) -> dict[str, Any]:
        """Return the task as plain data, without a range of goals where there is none; see `Task.to_document`."""
        document = super().to_document()
        if not self.goal_size:
            del document["goal_range"]
        return document

    @property
    def goal_yaw(self) -> float:
        """Yaw of the goal, rad."""
        return self.goal[2]

    def placed(self, q_WO: Sequence[float], vertices: np.ndarray, floor_height: float) -> Self:
        """Return the task of an object whose orientation at yaw 0 is q_WO (4,) wxyz; see `Task.placed`."""
        w, x, y, z = (float(value) for value in q_WO)
        return replace(self, q_WO=(w, x, y, z))

    def moved(self, x: float, y: float) -> Self:
        """Return the task whose goal is x, y [m] farther; see `Task.moved`."""
        return replace(self, goal=(self.goal[0] + x, self.goal[1] + y, self.goal[2]))

    def goal_pose(self, height: float) -> "Pose":
        """Pose X_WG of the object at the goal, its origin at a height [m]."""
        import torch

        from pinwm_drake.spatial.poses import Pose

        return Pose(torch.from_numpy(self.q_WG), torch.tensor([*self.goal[:2], height], dtype=torch.float64))

    def for_training(self) -> Self:
        """Return the task with the shaped reward, and success nearer: who ends at the limit often misses it."""
        nearer = {name: _NEARER * getattr(self, name) for name in ("tolerance", "turn_tolerance")}
        return replace(self, reward="shaped", **nearer)

    def measure(self, object_state: np.ndarray, p_WP: np.ndarray) -> Progress:
        """Horizontal distance, angle and success of W worlds; see `Task.measure`."""
        q_WO, p_WO = object_state[:, :4], object_state[:, 4:6]
        offset = p_WO - self.goal[:2]
        distance = np.hypot(offset[:, 0], offset[:, 1])
        share = np.abs(q_WO @ self.q_WG) / lengths(q_WO)
        angle = 2.0 * np.arccos(np.minimum(share, 1.0))
        reach = np.hypot(*(p_WP[:, :2] - p_WO).T)
        speed, turn = lengths(object_state[:, 10:13]), lengths(object_state[:, 7:10])
        at_rest = (speed < self.rest_speed) & (turn < self.rest_turn)
        success = (distance < self.tolerance) & (angle < self.turn_tolerance) & at_rest
        return Progress(distance, angle, reach, at_rest, success)

    def rewards(self, before: Progress, after: Progress) -> np.ndarray:
        """Rewards (W,) of the kind `reward`."""
        if self.reward == "paper":
            return -after.distance - after.angle
        gain: np.ndarray = _potential(before) - _potential(after) - self.cost + self.bonus * after.success
        return gain

    def state(self, object_state: np.ndarray, p_WP: np.ndarray) -> np.ndarray:
        """State (W, 11) float32 of W worlds, whose components the class describes; see `Task.state`."""
        goal, values = np.array(self.goal), np.empty((len(object_state), self.state_size))
        yaw = turn_from(np.array(self.q_WO), object_state[:, :4])
        turn = yaw - goal[2]
        p_WO = object_state[:, 4:6]
        values[:, 0:2] = _turned(p_WO - goal[:2], goal[2]) / LENGTH
        values[:, 2], values[:, 3] = np.cos(turn), np.sin(turn)
        values[:, 4:6] = _turned(object_state[:, 10:12], goal[2]) / SPEED
        values[:, 6] = object_state[:, 9] / TURN
        values[:, 7:9] = _turned(p_WP[:, :2] - p_WO, yaw) / LENGTH
        values[:, 9:11] = _turned(p_WP[:, :2] - goal[:2], goal[2]) / LENGTH
        return np.clip(np.nan_to_num(values), -self.state_bound, self.state_bound).astype(np.float32)

    def object_state(self, state: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Object (W, 13) and pusher (W, 3), both of no height; see `Task.object_state`."""
        state = np.asarray(state, float)
        yaw = np.arctan2(state[:, 3], state[:, 2]) + self.goal[2]
        found, p_WP = np.zeros((len(state), 13)), np.full((len(state), 3), np.nan)
        found[:, :4] = _turned_about_z(np.array(self.q_WO) / np.linalg.norm(self.q_WO), yaw)
        found[:, 4:6] = _turned(LENGTH * state[:, 0:2], -self.goal[2]) + self.goal[:2]
        found[:, 6] = np.nan
        found[:, 9] = TURN * state[:, 6]
        found[:, 10:12] = _turned(SPEED * state[:, 4:6], -self.goal[2])
        p_WP[:, :2] = _turned(LENGTH * state[:, 9:11], -self.goal[2]) + self.goal[:2]
        return found, p_WP

    def state_components(self) -> tuple[tuple[str, str], ...]:
        """Meaning and unit of the state's components; see `Task.state_components`."""
        length, speed, turn = f"{LENGTH:g} m", f"{SPEED:g} m/s", f"{TURN:g} rad/s"
        goal = "in the frame of the goal"
        return (
            (f"x of the object's origin, {goal}: its x and y, axes turned by its yaw", length),
            (f"y of the object's origin, {goal}", length),
            ("cos of the object's yaw, from the goal's", "1"),
            ("sin of the object's yaw, from the goal's", "1"),
            (f"x of the object's velocity, {goal}", speed),
            (f"y of the object's velocity, {goal}", speed),
            ("the object's rate of turn about z", turn),
            ("x of the pusher, from the object's origin, axes turned with the object", length),
            ("y of the pusher, from the object's origin, axes turned with the object", length),
            (f"x of the pusher, {goal}", length),
            (f"y of the pusher, {goal}", length),
        )

    def near_goal(self, state: np.ndarray, share: float = 1.0) -> bool:
        """Flag: the object is within a share of the tolerances of the goal, by components 0 to 3 of a state (11,)."""
        distance, turn = offset_from_goal(state)
        return distance < share * self.tolerance and turn < share * self.turn_tolerance


def turn_from(q_WO: np.ndarray, q_WB: np.ndarray) -> np.ndarray:
    """Turn (...) about the world's z [rad] that lead from an orientation to others, or nearest to them.

    Args:
        q_WO: (4,) wxyz, not zero: the orientation to turn.
        q_WB: (..., 4) wxyz, not zero: the orientations to reach.
    """
    w, x, y, z = np.moveaxis(q_WB, -1, 0)
    a, b, c, d = q_WO
    # The part of the product q_WB q_WO^-1 that turns about z.
    turn: np.ndarray = 2.0 * np.arctan2(z * a - w * d - x * c + y * b, w * a + x * b + y * c + z * d)
    return turn


def offset_from_goal(state: np.ndarray) -> tuple[float, float]:
    """Distance [m] and turn [rad], 0 to pi, of a state (11,) from the goal; NaN where its components are."""
    x, y, c, s = (float(value) for value in state[:4])
    return LENGTH * math.hypot(x, y), abs(math.atan2(s, c))


def _turned_about_z(q: np.ndarray, turn: np.ndarray | float) -> np.ndarray:
    """Orientations (4,) or (W, 4) wxyz after turns about the world's z [rad], one or (W,)."""
    (w, x, y, z), c, s = q.T, np.cos(0.5 * turn), np.sin(0.5 * turn)
    return np.stack([c * w - s * z, c * x - s * y, c * y + s * x, c * z + s * w], axis=-1)


def _turned(vectors: np.ndarray, yaw: np.ndarray | float) -> np.ndarray:
    """Components of vectors (W, 2) in axes that are turned by a yaw [rad], one for all or (W,)."""
    c, s = np.cos(yaw), np.sin(yaw)
    return np.stack([c * vectors[:, 0] + s * vectors[:, 1], c * vectors[:, 1] - s * vectors[:, 0]], axis=1)


def _potential(progress: Progress) -> np.ndarray:
    phi: np.ndarray = 10.0 * progress.distance + progress.angle + 2.0 * np.maximum(progress.reach - 0.1, 0.0)
    return phi
