# SPDX-License-Identifier: MIT
"""The model-predictive controller as a Drake system."""

import numpy as np
from pydrake.common.value import Value
from pydrake.systems.framework import BasicVector, Context, DiagramBuilder, EventStatus, LeafSystem, State

from pinwm_drake.systems.mpc.planner import Plan
from pinwm_drake.systems.mpc.policy import make_planner
from pinwm_drake.systems.ports import unowned
from pinwm_drake.systems.sampling import period_index, whole_multiple
from pinwm_drake.systems.scenario.setup import Setup
from pinwm_drake.systems.station.station import SceneStation
from pinwm_drake.tasks.push import PushTask


class PushMpc(LeafSystem):  # type: ignore[misc]  # pydrake has no usable types
    """Controller that plans pushes of an object to a goal on the floor, and moves the pusher along x and y.

                                         ┌─────────┐
        object_state  (13): q_WO wxyz,   │         │─► pusher_velocity_W  (3) [m/s], W
            p_WO [m], ω_WO, v_WO, W  ───►│ PushMpc │   a state: no direct feedthrough
        pusher_state  (6): p_WP [m],     │         │
            v_WP [m/s], W            ───►│         │─► plan  Value[object]: Plan, or None
        sampled at 0, H, 2 H, ...        └─────────┘

    H is the scenario's `pusher.horizon`. The velocity is level, no faster than max_translation / H, leads the pusher no
    farther than to its box, and is held for H. Where an input is not finite it is zero, and there is no plan: what is
    latched, is latched by a controller of a robot.

    Velocity and plan are state, so that a clone of a Context goes on as the original does; unrestricted updates set
    them, for the reason that `PusherTranslation` has.

    Args:
        setup: The scene as far as it is known, as for `make_planner`, and so are `task` and `max_translation`.
        period: s, at which the station samples the velocity, a whole fraction of the horizon; None for the horizon.

    Raises:
        InputError: A mesh cannot be used.
        ParameterError: See `make_planner`; or the horizon is no whole multiple of the period.
    """

    def __init__(
        self,
        setup: Setup,
        task: PushTask,
        max_translation: float | None = None,
        *,
        period: float | None = None,
    ) -> None:
        super().__init__()
        self.planner = make_planner(setup, task, max_translation)
        self._horizon = setup.scenario.pusher.horizon
        self._period = self._horizon if period is None else period
        self._periods = whole_multiple("horizon", self._horizon, self._period)
        self._object = self.DeclareVectorInputPort("object_state", 13)
        self._pusher = self.DeclareVectorInputPort("pusher_state", 6)
        self._velocity = self.DeclareDiscreteState(BasicVector(np.zeros(3)))
        self._plan = self.DeclareAbstractState(Value[object](None))
        self.DeclareStateOutputPort("pusher_velocity_W", self._velocity)
        self.DeclareStateOutputPort("plan", self._plan)
        self.DeclarePeriodicUnrestrictedUpdateEvent(self._period, 0.0, unowned(self, self._Plan))

    def plan(self, context: Context) -> Plan | None:
        """Return the last plan, None before the first; the context is of this system, or of a diagram around it."""
        return self.GetMyContextFromRoot(context).get_abstract_state(self._plan).get_value()

    def _Plan(self, context: Context, state: State) -> EventStatus:
        if period_index(context.get_time(), self._period) % self._periods:
            return EventStatus.DidNothing()
        seen, p_WP = self._object.Eval(context), self._pusher.Eval(context)[:3]
        velocity, plan = np.zeros(3), None
        if np.isfinite(seen).all() and np.isfinite(p_WP).all():
            last = context.get_abstract_state(self._plan).get_value()
            plan = self.planner.plan(self.planner.body.planar(seen), p_WP[:2], last)
            velocity[:2] = plan.d_W / self._horizon
        state.get_mutable_discrete_state(self._velocity).SetFromVector(velocity)
        state.get_mutable_abstract_state(self._plan).set_value(plan)
        return EventStatus.Succeeded()


def AddPushMpc(
    builder: DiagramBuilder,
    station: SceneStation,
    setup: Setup,
    task: PushTask,
    max_translation: float | None = None,
) -> PushMpc:
    """Add the controller of a station that is in the builder; its command is the velocity.

    Other arguments and errors are those of `PushMpc`.

    Args:
        builder: Builder of the diagram around the station.
        station: The station, whose input is `pusher_velocity_W`.
    """
    mpc = builder.AddNamedSystem("push_mpc", PushMpc(setup, task, max_translation, period=station.setup.period))
    for name in ("object_state", "pusher_state"):
        builder.Connect(station.GetOutputPort(name), mpc.GetInputPort(name))
    builder.Connect(mpc.GetOutputPort("pusher_velocity_W"), station.GetInputPort("pusher_velocity_W"))
    return mpc
