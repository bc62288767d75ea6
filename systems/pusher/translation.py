# SPDX-License-Identifier: MIT
"""Velocities of a pusher from actions that are translations over a horizon."""

import numpy as np
from pydrake.systems.framework import BasicVector, Context, EventStatus, LeafSystem, State

from pinwm_drake.systems.ports import unowned
from pinwm_drake.systems.pusher.limits import shortened
from pinwm_drake.systems.sampling import period_index, require_positive, whole_multiple


class PusherTranslation(LeafSystem):  # type: ignore[misc]  # pydrake has no usable types
    """Velocity v = d / H from a translation d, spread evenly over a horizon H.

                                               ┌───────────────────┐
        pusher_translation_W  (3 W) [m], W ───►│ PusherTranslation │─► pusher_velocity_W  (3 W) [m/s], W
        sampled at 0, H, 2 H, ...              └───────────────────┘   a state: no direct feedthrough

    A translation that is too long is shortened; its direction is kept. One with a component that is not a finite
    number is none. The velocity is zero until the first sample, which is taken when a simulator starts to advance.

    The state is discrete, but an unrestricted update sets it: of what is due at one instant, Drake runs these first,
    so that worlds which step at k H already see the k-th sample. (Discrete updates of one instant all see the values
    from before it; Drake's ZeroOrderHold would be late by one step of the worlds.) Events come at multiples of
    `period`, every N-th takes a sample: see `sampling`. For the same reason advance a simulator to (k N) period when
    the k-th sample is to be set from outside, not to k H, which may lie a rounding error later.

    Args:
        num_worlds: W, 1 or more.
        horizon: H, s.
        max_translation: m, the longest.
        period: s, that of the worlds which take the velocity; H is a whole multiple of it. None: H itself.

    Raises:
        ParameterError: A number is not positive, or the horizon no whole multiple of the period.
    """

    def __init__(self, num_worlds: int, horizon: float, max_translation: float, period: float | None = None) -> None:
        super().__init__()
        require_positive("num_worlds", num_worlds)
        self._horizon = require_positive("horizon", horizon, "s")
        self._longest = require_positive("max_translation", max_translation, "m")
        self._period = horizon if period is None else period
        self._periods = whole_multiple("horizon", horizon, self._period)
        self._translation = self.DeclareVectorInputPort("pusher_translation_W", 3 * num_worlds)
        self._held = self.DeclareDiscreteState(BasicVector(np.zeros(3 * num_worlds)))
        self.DeclareStateOutputPort("pusher_velocity_W", self._held)
        self.DeclarePeriodicUnrestrictedUpdateEvent(self._period, 0.0, unowned(self, self._Sample))

    def _Sample(self, context: Context, state: State) -> EventStatus:
        if period_index(context.get_time(), self._period) % self._periods:
            return EventStatus.DidNothing()
        d_W = shortened(self._translation.Eval(context).reshape(-1, 3), self._longest)
        state.get_mutable_discrete_state(self._held).SetFromVector(d_W.ravel() / self._horizon)
        return EventStatus.Succeeded()
