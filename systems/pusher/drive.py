# SPDX-License-Identifier: MIT
"""Drive of a plant's pusher, which holds a commanded velocity and integrates it."""

import numpy as np
from pydrake.systems.framework import BasicVector, Context, DiscreteValues, LeafSystem

from pinwm_drake.systems.ports import declare_vector, unowned
from pinwm_drake.systems.sampling import period_index

_P, _V, _INDEX = slice(0, 3), slice(3, 6), 6
_SHARE = 1e-6  # of a period, within which a time is that of a sample


class PusherDrive(LeafSystem):  # type: ignore[misc]  # pydrake has no usable types
    """Desired state of a plant's pusher from a velocity that is sampled and held.

                                       ┌─────────────┐
        pusher_velocity_W  (3) [m/s] ─►│ PusherDrive │─► desired_state   (6): p_WP [m], v_WP [m/s], W
        sampled at 0, T, 2 T, ...      └─────────────┘   one step of the plant ahead of the time

    The state (7), updated every T: p_WP and v_WP at the last sample, and which sample it was. The position is
    p + (t + h - k T) v, with the step h of the plant: where the pusher is to be when the step that begins at t ends.

    What is due at one instant, Drake updates from the state before it, so that a plant whose step begins at k T would
    see the velocity of the sample before; ZeroOrderHold is late in this way. From k T until the sample is in the
    state, the port hence depends on the input directly.

    Args:
        period: Period T of the samples, s.
        time_step: Time step h of the plant, s.
        p_WP: (3,) m, position of the pusher at the start, world.
    """

    def __init__(self, period: float, time_step: float, p_WP: np.ndarray) -> None:
        super().__init__()
        self._period, self._time_step = period, time_step
        self._velocity = self.DeclareVectorInputPort("pusher_velocity_W", 3)
        self._held = self.DeclareDiscreteState(BasicVector(_at_rest(p_WP)))
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, unowned(self, self._Sample))
        sources = {self.time_ticket(), self.xd_ticket(), self._velocity.ticket()}
        declare_vector(self, "desired_state", 6, self._CalcDesiredState, sources)

    def SetPosition(self, context: Context, p_WP: np.ndarray) -> None:
        """Start anew at p_WP (3,) m, at rest until the next sample; the context is that of this system."""
        context.SetDiscreteState(self._held, _at_rest(p_WP))

    def _Sample(self, context: Context, values: DiscreteValues) -> None:
        held, index = context.get_discrete_state(self._held).value(), period_index(context.get_time(), self._period)
        next_held = [*self._position(held, index), *self._velocity.Eval(context), index]
        values.get_mutable_vector(self._held).SetFromVector(next_held)

    def _position(self, held: np.ndarray, index: int) -> np.ndarray:
        """Position p_WP (3,) m that the pusher is to have at the index-th sample; after a jump of time the last one."""
        return held[_P] + self._period * held[_V] if index == held[_INDEX] + 1 else held[_P]

    def _CalcDesiredState(self, context: Context) -> np.ndarray:
        t, held = context.get_time(), context.get_discrete_state(self._held).value()
        index = period_index(t, self._period)
        p, v = held[_P], held[_V]
        since = t - index * self._period
        if index != held[_INDEX] and since < _SHARE * self._period:
            p, v = self._position(held, index), self._velocity.Eval(context)
        return np.concatenate([p + (since + self._time_step) * v, v])


def _at_rest(p_WP: np.ndarray) -> np.ndarray:
    return np.array([*np.asarray(p_WP, float).reshape(3), 0.0, 0.0, 0.0, -1.0])
