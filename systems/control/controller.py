# SPDX-License-Identifier: MIT
"""A policy as a controller: images in, limited velocities of the pusher out."""

import secrets
from dataclasses import dataclass, field

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import Context, DiagramBuilder, EventStatus, LeafSystem, State
from pydrake.systems.sensors import ImageRgba8U

from pinwm_drake.control.pilot import Acting, ControlStatus, Inputs, Memory, Pilot
from pinwm_drake.errors import ParameterError, require
from pinwm_drake.learning.safety import SafetyLimits
from pinwm_drake.systems.envs.policy_scene import check_scene
from pinwm_drake.systems.ports import Immutable, declare_value, declare_vector, unowned
from pinwm_drake.systems.sampling import period_index, whole_multiple
from pinwm_drake.systems.station.station import SceneStation

_LONGEST = 200  # characters of a fault
_SESSIONS = 1 << 48  # whole numbers that a double holds


@dataclass(frozen=True, eq=False)
class _Held(Immutable):
    """State of the controller: the pilot's, and the session in which it commands a robot; 0 unless armed."""

    memory: Memory = field(default_factory=Memory)
    session: int = 0


class PolicyController(LeafSystem):  # type: ignore[misc]  # pydrake has no usable types
    """Controller by a policy: acts every horizon H, moves the pusher within limits, once armed, until it ends.

                                              ┌──────────────────┐─► pusher_velocity_W  (3) [m/s], W: limited
        rgb           ImageRgba8U ───────────►│                  │─► raw_action         (n) [m], W: the policy's own
        rgb_time      (1) s, when it was taken│                  │─► estimate  Value[array]: the task's state, as the
        pusher_state  (6): p_WP [m],          │ PolicyController │             policy sees it; empty where it tells none
                           v_WP [m/s], W   ──►│                  │─► status   Value[ControlStatus]
        pusher_time   (1) s, when it was there│                  │─► command_time       (1) s, of the last action
        fault         Value[str]: the ───────►│                  │─► session            (1): a random number while
                      station's own           └──────────────────┘   armed, or 0    states: no direct feedthrough

    At 0, H, 2 H, ... the policy sees the last k images, one an action (the first since a reset stands for those before
    it), and where the pusher was when the last was taken; its translation d is sent as d / H, held for H. A fault is
    looked for at each `period`; see `Pilot` and `SafetyFilter`, which every velocity goes through. An exception,
    in the policy or elsewhere, is a fault too.

    A controller starts disarmed: it computes and tells what it would do (`raw_action`, NaN where there is none), and
    sends zero. `Arm` lets it move from the next action on. After a fault, or when the task is over, it sends zero until
    `Reset` and `Arm`.

    The state is set by an unrestricted update, for the reason that `PusherTranslation` gives: what is due at one
    instant, Drake runs after it, so that the worlds which step at k H move by the action on the image of k H, as in
    `TaskEnv`.

    Args:
        bundle: The policy.
        limits: Limits of the pusher's motion.
        period: s, period of the worlds that take the velocity; H is a whole multiple of it. None for H itself.
        live: Flag: images come from a real camera; see `Pilot`.

    Attributes:
        spec: Specification of the policy; n is its number of action components.

    Raises:
        ParameterError: The policy sees no images, limits are missing, or the horizon is no whole multiple.
    """

    def __init__(
        self, bundle: Acting, limits: SafetyLimits, period: float | None = None, *, live: bool = False
    ) -> None:
        super().__init__()
        spec = bundle.spec
        require("policy", f"one that observes {spec.observes!r}", spec.observes == "rgb", "'rgb'")
        self.spec, self.limits = spec, limits
        self._pilot = Pilot(bundle, limits, live=live)
        size = (spec.camera.height, spec.camera.width)
        self._period = spec.horizon if period is None else period
        self._periods = whole_multiple("horizon", spec.horizon, self._period)
        self._rgb = self.DeclareAbstractInputPort("rgb", AbstractValue.Make(ImageRgba8U(*reversed(size))))
        self._rgb_time = self.DeclareVectorInputPort("rgb_time", 1)
        self._pusher = self.DeclareVectorInputPort("pusher_state", 6)
        self._pusher_time = self.DeclareVectorInputPort("pusher_time", 1)
        self._fault = self.DeclareAbstractInputPort("fault", AbstractValue.Make(""))
        self._held = self.DeclareAbstractState(AbstractValue.Make(_Held()))
        held = {self.abstract_state_ticket(self._held)}
        get, none = self._get, np.full(spec.action_size, np.nan)
        declare_vector(self, "pusher_velocity_W", 3, lambda mine: get(mine).memory.safety.v_WP, held)
        declare_vector(self, "raw_action", len(none), lambda mine: get(mine).memory.raw_action or none, held)
        declare_value(self, "estimate", object(), lambda mine: np.array(get(mine).memory.state), held)
        declare_value(self, "status", ControlStatus(), lambda mine: get(mine).memory.status, held)
        declare_vector(self, "command_time", 1, lambda mine: [get(mine).memory.command_time], held)
        declare_vector(self, "session", 1, lambda mine: [get(mine).session], held)
        self.DeclarePeriodicUnrestrictedUpdateEvent(self._period, 0.0, unowned(self, self._Update))

    def Arm(self, context: Context) -> None:
        """Let the policy move the pusher, from the next action on, in a session of its own.

        Args:
            context: Context of this system, or of the outermost diagram around it.

        Raises:
            StateError: A fault latched the controller, or its task is over; `Reset` first.
        """
        held = self._mine(context)
        session = held.session or 1 + secrets.randbelow(_SESSIONS)
        self._put(context, _Held(self._pilot.arm(held.memory, context.get_time()), session))

    def Disarm(self, context: Context) -> None:
        """Stop the pusher; a fault that latched stays; context as for `Arm`."""
        self._put(context, _Held(self._pilot.disarm(self._mine(context).memory, context.get_time())))

    def Fail(self, context: Context, fault: str) -> None:
        """Take note of a fault [words] found by somebody else, which latches while armed; context as for `Arm`."""
        held = self._mine(context)
        self._put(context, _of(held, self._pilot.fail(held.memory, context.get_time(), fault)))

    def Reset(self, context: Context) -> None:
        """Forgets fault, end and images, as at the beginning of an episode, and disarms; context as for `Arm`."""
        self._put(context, _Held(Memory(status=ControlStatus(time=context.get_time()))))

    def status(self, context: Context) -> ControlStatus:
        """Status of the controller, as its port has it; context as for `Arm`."""
        return self._mine(context).memory.status

    def _mine(self, context: Context) -> _Held:
        return self._get(self.GetMyContextFromRoot(context))

    def _get(self, context: Context) -> _Held:
        return context.get_abstract_state(int(self._held)).get_value()

    def _put(self, context: Context, held: _Held) -> None:
        self.GetMyMutableContextFromRoot(context).get_mutable_abstract_state(int(self._held)).set_value(held)

    def _Update(self, context: Context, state: State) -> EventStatus:
        held, time = self._get(context), context.get_time()
        inputs = Inputs(
            time=time,
            image_time=float(self._rgb_time.Eval(context)[0]),
            rgb=lambda: np.asarray(self._rgb.Eval(context).data),
            # Where nobody says otherwise, it is where it is now, and nothing is wrong.
            pusher_time=float(self._pusher_time.Eval(context)[0]) if self._pusher_time.HasValue(context) else time,
            pusher_state=self._pusher.Eval(context),
            fault=self._fault.Eval(context) if self._fault.HasValue(context) else "",
        )
        acts = period_index(time, self._period) % self._periods == 0
        try:
            memory = (self._pilot.act if acts else self._pilot.look)(held.memory, inputs)
        except Exception as error:  # whatever came in, a robot is not to go on
            words = f"controller failed: {type(error).__name__}: {error}"[:_LONGEST]
            memory = self._pilot.fail(held.memory, time, words)
        if memory is held.memory:
            return EventStatus.DidNothing()
        state.get_mutable_abstract_state(int(self._held)).set_value(_of(held, memory))
        return EventStatus.Succeeded()


def AddPolicyController(
    builder: DiagramBuilder, station: SceneStation, bundle: Acting, limits: SafetyLimits
) -> PolicyController:
    """Add a controller, disarmed, and connect it with a station of any engine.

    Args:
        builder: Builder of a diagram that has the station already.
        station: The station; its input is `pusher_velocity_W`.
        bundle: The policy.
        limits: Limits of the pusher's motion.

    Returns:
        The controller, with the name "policy_controller".

    Raises:
        ParameterError: The station's camera, pusher's box or horizon is not the policy's, it holds several worlds, or
            it takes translations.
    """
    setup = station.setup
    if setup.scenario.num_worlds != 1 or not station.HasInputPort("pusher_velocity_W"):
        given = f"{setup.scenario.num_worlds} worlds, input {station.get_input_port(0).get_name()}"
        raise ParameterError(f"station: got {given}; allowed: one world, and command='velocity'")
    check_scene(bundle.spec, setup)
    live = station.engine.name == "lcm"
    controller = builder.AddNamedSystem("policy_controller", PolicyController(bundle, limits, setup.period, live=live))
    for name in ("rgb", "rgb_time", "pusher_state", "pusher_time", "fault"):
        builder.Connect(station.GetOutputPort(name), controller.GetInputPort(name))
    for name in ("pusher_velocity_W", "session"):
        if station.HasInputPort(name):
            builder.Connect(controller.GetOutputPort(name), station.GetInputPort(name))
    return controller


def _of(held: _Held, memory: Memory) -> _Held:
    """Return the controller's state with another memory; a session is over where the pusher may not move any more."""
    return _Held(memory, held.session if memory.safety.mode in ("armed", "running") else 0)
