"""The push task: where the object is to go, how far it is from there, and what a step is worth."""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from pydrake.common.eigen_geometry import Quaternion
from pydrake.math import RigidTransform, RotationMatrix

from pinwm_drake.errors import ParameterError

Reward = Literal["paper", "shaped"]
REWARDS = ("paper", "shaped")


@dataclass(frozen=True, eq=False)
class Progress:
    """Where W worlds stand.

    Attributes:
        distance: d_t (W,) m, horizontal, from the object's origin to the goal.
        angle: d_r (W,) rad, 0 to pi, between the object's orientation and the goal's.
        reach: (W,) m, horizontal, from the pusher to the object's origin.
        at_rest: (W,) bool.
        success: (W,) bool: near enough, turned little enough, and at rest.
    """

    distance: np.ndarray
    angle: np.ndarray
    reach: np.ndarray
    at_rest: np.ndarray
    success: np.ndarray


@dataclass(frozen=True)
class PushTask:
    """An object is to be pushed to a fixed pose on the floor, and to rest there.

    Rewards, of a step that ends at d_t [m] and d_r [rad]:

        paper    -d_t - d_r
        shaped   phi(before) - phi(after) - cost + bonus on success,
                 phi = 10 d_t + d_r + 2 max(0, reach - 0.1)    with the pusher's distance `reach` [m]

    The shaped one is a difference of potentials, so that it leaves the order of policies as it is but for the cost of
    time; the last term brings the pusher to the object.

    Attributes:
        goal: x [m], y [m], yaw [rad] of the object's frame O in the world; yaw is a turn about z after `q_WO`.
        q_WO: (4,) wxyz, how the object lies at yaw 0.
        reward: "paper" or "shaped".
        tolerance: m, of d_t.
        turn_tolerance: rad, of d_r.
        rest_speed: m/s, below which the object rests. Friction of 0.03 stops it within 0.05 mm from there.
        rest_turn: rad/s, below which it does.
        cost: Of a step, in the shaped reward.
        bonus: On success, in the shaped reward.

    Raises:
        ParameterError: There is no such reward, or a number is not finite or not positive.
    """

    goal: tuple[float, float, float] = (0.0, 0.0, 0.0)
    q_WO: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)
    reward: Reward = "paper"
    tolerance: float = 0.02
    turn_tolerance: float = 0.2
    rest_speed: float = 0.005
    rest_turn: float = 0.05
    cost: float = 0.01
    bonus: float = 10.0

    def __post_init__(self) -> None:
        """Checks the values."""
        if self.reward not in REWARDS:
            raise ParameterError(f"reward: got {self.reward!r}; allowed: {', '.join(REWARDS)}")
        if len(self.goal) != 3 or not all(math.isfinite(value) for value in self.goal):
            raise ParameterError(f"goal: got {self.goal}; allowed: x [m], y [m] and yaw [rad], finite")
        for name in ("tolerance", "turn_tolerance", "rest_speed", "rest_turn"):
            if not 0 < getattr(self, name) < math.inf:
                raise ParameterError(f"{name}: got {getattr(self, name)}; allowed: more than 0")

    @cached_property
    def R_WG(self) -> RotationMatrix:
        """The object's orientation at the goal."""
        q_WO = np.array(self.q_WO)
        return RotationMatrix.MakeZRotation(self.goal[2]) @ RotationMatrix(Quaternion(wxyz=q_WO / np.linalg.norm(q_WO)))

    @cached_property
    def _q_WG(self) -> np.ndarray:
        """(4,) wxyz."""
        q_WG: np.ndarray = self.R_WG.ToQuaternion().wxyz()
        return q_WG

    def X_WG(self, height: float) -> RigidTransform:
        """The object's pose at the goal, its origin at a height [m]."""
        return RigidTransform(self.R_WG, [*self.goal[:2], height])

    def measure(self, object_state: np.ndarray, p_WP: np.ndarray) -> Progress:
        """Where worlds stand.

        Args:
            object_state: (W, 13) as the station's port has it.
            p_WP: (W, 3) m.
        """
        q_WO, p_WO = object_state[:, :4], object_state[:, 4:6]
        offset = p_WO - self.goal[:2]
        distance = np.hypot(offset[:, 0], offset[:, 1])
        share = np.abs(q_WO @ self._q_WG) / _lengths(q_WO)
        angle = 2.0 * np.arccos(np.minimum(share, 1.0))
        reach = np.hypot(*(p_WP[:, :2] - p_WO).T)
        speed, turn = _lengths(object_state[:, 10:13]), _lengths(object_state[:, 7:10])
        at_rest = (speed < self.rest_speed) & (turn < self.rest_turn)
        success = (distance < self.tolerance) & (angle < self.turn_tolerance) & at_rest
        return Progress(distance, angle, reach, at_rest, success)

    def rewards(self, before: Progress, after: Progress) -> np.ndarray:
        """(W,): what a step from `before` to `after` is worth."""
        if self.reward == "paper":
            return -after.distance - after.angle
        gain: np.ndarray = _potential(before) - _potential(after) - self.cost + self.bonus * after.success
        return gain


def turn_from(q_WO: np.ndarray, q_WB: np.ndarray) -> np.ndarray:
    """The turn about z [rad] that leads from an orientation to others, as far as one does.

    Args:
        q_WO: (4,) wxyz, not zero.
        q_WB: (..., 4) wxyz.
    """
    w, x, y, z = np.moveaxis(q_WB, -1, 0)
    a, b, c, d = q_WO
    # Of the product q_WB q_WO^-1, the part that turns about z.
    turn: np.ndarray = 2.0 * np.arctan2(z * a - w * d - x * c + y * b, w * a + x * b + y * c + z * d)
    return turn


def _lengths(vectors: np.ndarray) -> np.ndarray:
    """(W,) of vectors (W, n); numpy's norm takes three times as long for so few."""
    lengths: np.ndarray = np.sqrt(np.einsum("ij,ij->i", vectors, vectors))
    return lengths


def _potential(progress: Progress) -> np.ndarray:
    """Phi of the shaped reward, (W,)."""
    phi: np.ndarray = 10.0 * progress.distance + progress.angle + 2.0 * np.maximum(progress.reach - 0.1, 0.0)
    return phi
