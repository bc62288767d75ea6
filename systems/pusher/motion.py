# SPDX-License-Identifier: MIT
"""Motions of a pusher, straight pushes with a trapezoid of speed and recorded ones, and the systems that play them."""

import math
from dataclasses import dataclass

import numpy as np
from pydrake.systems.framework import BasicVector, Context, LeafSystem, NumericParameterIndex

from pinwm_drake.capture.episodes import PusherTrajectory
from pinwm_drake.scene import pusher_motion
from pinwm_drake.systems.ports import declare_vector
from pinwm_drake.systems.sampling import period_index, require_positive


@dataclass(frozen=True, eq=False)
class StraightPush:
    """Push along a straight line, from rest to rest, with a trapezoid of speed.

    Attributes:
        p_WP: (3,) m, position at the start, world.
        direction_W: (3,), unit, direction of the motion, world.
        speed: Speed between speeding up and slowing down, m/s.
        distance: Distance from start to stop, m.
        acceleration: Acceleration at both ends, m/s^2.
        delay: Time before it starts, s.

    Raises:
        ValueError: `speed`, `distance` or `acceleration` is not positive, or the distance is too short for the speed.
    """

    p_WP: np.ndarray
    direction_W: np.ndarray
    speed: float
    distance: float
    acceleration: float
    delay: float = 0.0

    def __post_init__(self) -> None:
        if not (self.speed > 0 and self.acceleration > 0 and self.distance >= self.speed**2 / self.acceleration):
            raise ValueError(f"{self}: allowed: a distance of speed^2 / acceleration or more, all three positive")

    @property
    def end_time(self) -> float:
        """Time at which the pusher stops, s."""
        return self.delay + self.distance / self.speed + self.speed / self.acceleration

    def travel(self, t: float) -> tuple[float, float]:
        """Distance travelled [m] and speed [m/s] at the time t [s]."""
        ramp = self.speed / self.acceleration
        since, left = t - self.delay, self.end_time - t
        if since <= 0:
            return 0.0, 0.0
        if left <= 0:
            return self.distance, 0.0
        if since < ramp:
            return 0.5 * self.acceleration * since**2, self.acceleration * since
        if left < ramp:
            return self.distance - 0.5 * self.acceleration * left**2, self.acceleration * left
        return self.speed * (since - 0.5 * ramp), self.speed

    def average_velocity(self, index: int, period: float) -> np.ndarray:
        """Average velocity v_WP (3,) [m/s] from `index` periods [s] to one more."""
        way = self.travel((index + 1) * period)[0] - self.travel(index * period)[0]
        return way / period * self.direction_W

    def to_vector(self) -> np.ndarray:
        """Numbers (10,) that describe the push, in the order of the attributes."""
        rest = [self.speed, self.distance, self.acceleration, self.delay]
        return np.concatenate([self.p_WP, self.direction_W, rest])

    @classmethod
    def from_vector(cls, values: np.ndarray) -> "StraightPush":
        """Push from its numbers (10,), the inverse of `to_vector`."""
        return cls(values[:3], values[3:6], *(float(value) for value in values[6:]))


class ScriptedPush(LeafSystem):  # type: ignore[misc]  # pydrake has no usable types
    """Velocity of a pusher along a straight push, which is a parameter of the context.

                        ┌──────────────┐
                        │ ScriptedPush │─► pusher_velocity_W  (3) [m/s], W
                        └──────────────┘   function of time and parameter, constant on [k, k + 1) period

    The velocity is the average over its period, so that a pusher that starts at the push's p_WP is where the push
    has it at the end of every period. The parameter, group 0, is `StraightPush.to_vector()`, so that a diagram serves
    one push after another; until one is set, the pusher stands.

    Args:
        period: Period of the velocity, s.

    Raises:
        ParameterError: It is not positive.
    """

    def __init__(self, period: float) -> None:
        super().__init__()
        self._period = require_positive("period", period, "s")
        stand = StraightPush(np.zeros(3), np.array([1.0, 0.0, 0.0]), 1.0, 1.0, 1.0, math.inf)
        self._push = self.DeclareNumericParameter(BasicVector(stand.to_vector()))
        parameter = self.numeric_parameter_ticket(NumericParameterIndex(self._push))
        declare_vector(self, "pusher_velocity_W", 3, self._CalcVelocity, {self.time_ticket(), parameter})

    def SetPush(self, context: Context, push: StraightPush) -> None:
        """Set the push of this system's context."""
        context.get_mutable_numeric_parameter(self._push).SetFromVector(push.to_vector())

    def _CalcVelocity(self, context: Context) -> np.ndarray:
        push = StraightPush.from_vector(context.get_numeric_parameter(self._push).CopyToVector())
        return push.average_velocity(period_index(context.get_time(), self._period), self._period)


class TrajectoryReplay(LeafSystem):  # type: ignore[misc]  # pydrake has no usable types
    """Velocity of a pusher along a recorded trajectory.

                        ┌──────────────────┐
                        │ TrajectoryReplay │─► pusher_velocity_W  (3) [m/s], W
                        └──────────────────┘   function of time, constant on [k, k + 1) period

    The velocity is the average over its period, so that a pusher that starts at `start_position` is on the log's
    line, which is straight between rows, at the end of every period. Before the first and after the last row it
    stands. These are the very velocities that identification uses (`scene.pusher_motion`). Pushers of a station only
    translate: turning is left out.

    Args:
        trajectory: The recorded trajectory.
        period: Period of the velocity, s.
        start: Time of the log at the context's time 0, s.

    Raises:
        ParameterError: The period is not positive.
    """

    def __init__(self, trajectory: PusherTrajectory, period: float, start: float = 0.0) -> None:
        super().__init__()
        self._period = require_positive("period", period, "s")
        periods = max(math.ceil((trajectory.t[-1] - start) / period), 0)
        motion = pusher_motion(trajectory, start, periods, period)
        self._v_WP = motion.V_WP[:, 3:].numpy()
        self._p_WP = motion.p_WP.numpy()
        declare_vector(self, "pusher_velocity_W", 3, self._CalcVelocity, {self.time_ticket()})

    @property
    def start_position(self) -> np.ndarray:
        """Position p_WP (3,) m, world, that the pusher has to have at the context's time 0."""
        return self._p_WP.copy()

    def _CalcVelocity(self, context: Context) -> np.ndarray:
        k = period_index(context.get_time(), self._period)
        return np.asarray(self._v_WP[k] if 0 <= k < len(self._v_WP) else np.zeros(3))
