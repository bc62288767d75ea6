# SPDX-License-Identifier: MIT
"""Interpolation of commands: smooth motion for a robot from velocities that come now and then."""

import numpy as np
from pydrake.systems.framework import BasicVector, Context, DiscreteValues, LeafSystem

from pinwm_drake.control.velocity_limiter import VelocityLimiter
from pinwm_drake.errors import ParameterError, StateError
from pinwm_drake.learning.safety import SafetyLimits
from pinwm_drake.systems.ports import declare_vector, unowned
from pinwm_drake.systems.sampling import require_positive

RATE = 200.0  # Hz
_P, _V, _STAMP, _CAME, _LIVE, _WANTED = slice(0, 3), slice(3, 6), 6, 7, 8, slice(9, 12)
_SHARE = 1e-6  # of a period, by which a time may be off


class CommandInterpolator(LeafSystem):  # type: ignore[misc]  # pydrake has no usable types
    """Position and velocity of the pusher for a robot's servo, every T, within limits whatever comes in.

        pusher_velocity_W  (3) [m/s], W: the  ┌─────────────────────┐
                           last command ─────►│                     │─► desired_state  (6): p_WP [m], v_WP [m/s], W
        command_time  (1): another with every │ CommandInterpolator │   of the last sample
                           command       ────►│                     │─► live           (1): 1 while commands come, or 0
        pusher_state  (6): measured p_WP [m], │                     │─► wanted         (3): v_WP [m/s] that it goes
                           v_WP [m/s], W ────►│                     │   towards
                                              └─────────────────────┘   states: no direct feedthrough; updated every T

    The velocity goes towards the one commanded as fast as `VelocityLimiter` allows, and the position is its integral
    from where the pusher was measured when a simulator was initialized. So position, speed and acceleration keep their
    limits at every sample, and the pusher brakes before a wall.

    Commands are told by their `command_time`, of which only changes count: what clock it is of makes no difference, and
    a command that was there before the beginning is none. When the last is older than `max_command_age`, has a
    component that is not a finite number, or the measured pusher is lost, the velocity wanted is zero: the pusher slows
    down within the acceleration limit. A pusher that is measured farther than `max_lag` from where it is to be, since
    something holds it, is led no farther away.

    Args:
        limits: Limits of the motion.
        period: T, s.

    Raises:
        ParameterError: The period is not positive, or longer than the age of a command may be.
    """

    def __init__(self, limits: SafetyLimits, period: float = 1.0 / RATE) -> None:
        super().__init__()
        self.limits, self.period = limits, require_positive("period", period, "s")
        if period >= limits.max_command_age:
            raise ParameterError(
                f"period: got {period:g} s; allowed: less than max_command_age, {limits.max_command_age:g} s"
            )
        self._limiter = VelocityLimiter(limits, period)
        self._velocity = self.DeclareVectorInputPort("pusher_velocity_W", 3)
        self._stamp = self.DeclareVectorInputPort("command_time", 1)
        self._measured = self.DeclareVectorInputPort("pusher_state", 6)
        self._held = self.DeclareDiscreteState(BasicVector(_at_rest(np.zeros(3), 0.0)))
        self.DeclareInitializationDiscreteUpdateEvent(unowned(self, self._Begin))
        # A discrete update sees the command of a controller that acts, by an unrestricted one, at the same instant.
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, unowned(self, self._Update))
        held = {self.xd_ticket()}
        declare_vector(self, "desired_state", 6, lambda context: self._state(context)[:6], held)
        declare_vector(self, "live", 1, lambda context: self._state(context)[[_LIVE]], held)
        declare_vector(self, "wanted", 3, lambda context: self._state(context)[_WANTED], held)

    def _Begin(self, context: Context, values: DiscreteValues) -> None:
        p_WP = self._measured.Eval(context)[:3]
        if not np.isfinite(p_WP).all():
            raise StateError(f"pusher_state: got {p_WP.tolist()} m at the beginning; allowed: a position that is known")
        values.get_mutable_vector(self._held).SetFromVector(_at_rest(p_WP, self._stamp.Eval(context)[0]))

    def _Update(self, context: Context, values: DiscreteValues) -> None:
        held, time = self._state(context), context.get_time()
        v_WP, stamp, measured = self._velocity.Eval(context), self._stamp.Eval(context)[0], self._measured.Eval(context)
        # Where the last sample's velocity has led.
        p_WP = held[_P] + self.period * held[_V]
        stamp = stamp if np.isfinite(stamp) else held[_STAMP]
        came = time if stamp != held[_STAMP] else held[_CAME]
        live = time - came <= self.limits.max_command_age + _SHARE * self.period
        wanted = np.zeros(3)
        if live and np.isfinite(v_WP).all() and np.isfinite(measured).all():
            wanted = self._led(v_WP, p_WP - measured[:3])
        v_next = self._limiter.limit(wanted, held[_V], p_WP)
        values.get_mutable_vector(self._held).SetFromVector([*p_WP, *v_next, stamp, came, float(live), *wanted])

    def _led(self, v_WP: np.ndarray, lag: np.ndarray) -> np.ndarray:
        """Velocity (3,) m/s without the part along a lag (3,) m that is too long already."""
        length = float(np.linalg.norm(lag))
        if length <= self.limits.max_lag:
            return v_WP
        away, v_WP = lag / length, self._limiter.shortened(v_WP)
        return np.asarray(v_WP - max(float(v_WP @ away), 0.0) * away)

    def _state(self, context: Context) -> np.ndarray:
        return np.asarray(context.get_discrete_state(self._held).value())


def _at_rest(p_WP: np.ndarray, stamp: float) -> np.ndarray:
    """State (12,) before any command: p_WP, v_WP, stamp, time of arrival, flag: commands come, and velocity wanted."""
    return np.array([*p_WP, 0.0, 0.0, 0.0, stamp, -np.inf, 0.0, 0.0, 0.0, 0.0])
