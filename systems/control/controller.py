"""A policy as a controller: images in, limited velocities of the pusher out."""

from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import BasicVector, Context, DiagramBuilder, EventStatus, LeafSystem, State
from pydrake.systems.sensors import ImageRgba8U

from pinwm_drake.errors import ParameterError
from pinwm_drake.learning.safety import SafetyLimits
from pinwm_drake.learning.spec import PolicySpec
from pinwm_drake.systems.control.safety_filter import Mode, Safety, SafetyFilter
from pinwm_drake.systems.envs.policy_scene import check_scene
from pinwm_drake.systems.sampling import period_index, whole_multiple
from pinwm_drake.systems.station.station import PushStation


class Acting(Protocol):
    """Policy in physical units, such as a bundle, as a controller takes it."""

    @property
    def spec(self) -> PolicySpec:
        """Specification of the policy, which observes "rgb"."""

    def act(self, image: np.ndarray, p_WP: np.ndarray) -> np.ndarray:
        """Translation d_W (n,) m of the pusher along the task's axes over the horizon, world.

        Args:
            image: (height, width, 3 k) uint8, RGB: the last k images, the oldest first.
            p_WP: (n,) m, world: position of the pusher along the task's axes.
        """


@dataclass(frozen=True)
class ControlStatus:
    """Status of a controller, and the reason for it.

    Attributes:
        state: "disarmed", "armed", "running" or "latched"; see `Safety`.
        reason: The fault that latched it, or the present one while disarmed; empty where there is none.
        time: s, of the last action or change.
        image_age: s, age of the image at that time; NaN before the first.
        actions: Number of actions that the policy has computed since the last reset.
        limited: Flag: the limits changed the last action.
    """

    state: Mode = "disarmed"
    reason: str = ""
    time: float = 0.0
    image_age: float = float("nan")
    actions: int = 0
    limited: bool = False


@dataclass(frozen=True, eq=False)
class _Held:
    """State of the controller: images (height, width, 3) uint8, the oldest first, and the action that followed."""

    safety: Safety = field(default_factory=Safety)
    images: tuple[np.ndarray, ...] = ()
    image_time: float = -np.inf
    raw_action: tuple[float, ...] = ()  # none where it is empty
    command_time: float = -1.0
    status: ControlStatus = field(default_factory=ControlStatus)


class PolicyController(LeafSystem):  # type: ignore[misc]  # pydrake has no usable types
    """Controller by a policy: acts every horizon H, moves the pusher within limits, once armed, until the first fault.

                                              ┌──────────────────┐─► pusher_velocity_W  (3) [m/s], W: limited
        rgb           ImageRgba8U ───────────►│                  │─► raw_action         (n) [m], W: the policy's own
        rgb_time      (1) s, when it was taken│ PolicyController │─► status   Value[ControlStatus]
        pusher_state  (6): p_WP [m],          │                  │─► command_time       (1) s, of the last action
                           v_WP [m/s], W   ──►│                  │
                                              └──────────────────┘   states: no direct feedthrough

    At 0, H, 2 H, ... the policy sees the last k images, one an action (the first since a reset stands for those before
    it), and the pusher's position; its translation d is sent as d / H, held for H. A fault is looked for at each
    `period`, and in images and actions each H: see `SafetyFilter`, which every velocity goes through. An exception in
    the policy is a fault too.

    A controller starts disarmed: it computes and tells what it would do (`raw_action`, NaN where there is none), and
    sends zero. `Arm` lets it move from the next action on. After a fault it sends zero until `Reset` and `Arm`.

    The state is set by an unrestricted update, for the reason that `PusherTranslation` gives: what is due at one
    instant, Drake runs after it, so that the worlds which step at k H move by the action on the image of k H, as in
    `TaskEnv`.

    Attributes:
        spec: Specification of the policy; n is its number of action components.
        limits: Limits of the pusher's motion.
    """

    def __init__(self, bundle: Acting, limits: SafetyLimits, period: float | None = None) -> None:
        """Declares state, ports and event; there is no controller without limits.

        Args:
            bundle: The policy.
            limits: Limits of the pusher's motion.
            period: s, period of the worlds that take the velocity; H is a whole multiple of it. None for H itself.

        Raises:
            ParameterError: The policy sees no images, limits are missing, or the horizon is no whole multiple.
        """
        super().__init__()
        spec = bundle.spec
        if spec.observes != "rgb":
            raise ParameterError(f"policy: got one that observes {spec.observes!r}; allowed: 'rgb'")
        self.spec, self.limits, self._bundle = spec, limits, bundle
        size = (spec.camera.height, spec.camera.width)
        self._filter = SafetyFilter(limits, spec.horizon, size, spec.task)
        self._period = spec.horizon if period is None else period
        self._periods = whole_multiple("horizon", spec.horizon, self._period)
        self._rgb = self.DeclareAbstractInputPort("rgb", AbstractValue.Make(ImageRgba8U(*reversed(size))))
        self._rgb_time = self.DeclareVectorInputPort("rgb_time", 1)
        self._pusher = self.DeclareVectorInputPort("pusher_state", 6)
        self._held = self.DeclareAbstractState(AbstractValue.Make(_Held()))
        held = {self.abstract_state_ticket(self._held)}
        self.DeclareVectorOutputPort("pusher_velocity_W", 3, self._CalcVelocity, held)
        self.DeclareVectorOutputPort("raw_action", spec.action_size, self._CalcRawAction, held)
        self.DeclareAbstractOutputPort("status", lambda: AbstractValue.Make(ControlStatus()), self._CalcStatus, held)
        self.DeclareVectorOutputPort("command_time", 1, self._CalcCommandTime, held)
        self.DeclarePeriodicUnrestrictedUpdateEvent(self._period, 0.0, self._Update)

    def Arm(self, context: Context) -> None:
        """Lets the policy move the pusher, from the next action on.

        Args:
            context: Context of this system, or of the outermost diagram around it.

        Raises:
            StateError: A fault latched the controller; `Reset` first.
        """
        self._put(context, self._filter.arm(self._mine(context).safety))

    def Disarm(self, context: Context) -> None:
        """Stops the pusher; a fault that latched stays; context as for `Arm`."""
        self._put(context, self._filter.disarm(self._mine(context).safety))

    def Reset(self, context: Context) -> None:
        """Forgets fault and images, as at the beginning of an episode, and disarms; context as for `Arm`."""
        state = self.GetMyMutableContextFromRoot(context).get_mutable_abstract_state(int(self._held))
        state.set_value(_Held(status=ControlStatus(time=context.get_time())))

    def status(self, context: Context) -> ControlStatus:
        """Status of the controller, as its port has it; context as for `Arm`."""
        return self._mine(context).status

    def _mine(self, context: Context) -> _Held:
        return self._get(self.GetMyContextFromRoot(context))

    def _get(self, context: Context) -> _Held:
        held: _Held = context.get_abstract_state(int(self._held)).get_value()
        return held

    def _put(self, context: Context, safety: Safety) -> None:
        held = _with(self._mine(context), safety, time=context.get_time())
        self.GetMyMutableContextFromRoot(context).get_mutable_abstract_state(int(self._held)).set_value(held)

    def _Update(self, context: Context, state: State) -> EventStatus:
        held, time = self._get(context), context.get_time()
        acts = period_index(time, self._period) % self._periods == 0
        image_time, pusher = float(self._rgb_time.Eval(context)[0]), self._pusher.Eval(context)
        fault = self._filter.fault(time, image_time, pusher, last_image_time=held.image_time)
        if acts:
            held = self._act(context, held, fault, image_time, pusher[:3])
        else:
            safety = self._filter.watch(held.safety, fault)
            if safety == held.safety:
                return EventStatus.DidNothing()
            held = _with(held, safety, time=time, image_age=time - image_time)
        state.get_mutable_abstract_state(int(self._held)).set_value(held)
        return EventStatus.Succeeded()

    def _act(self, context: Context, held: _Held, fault: str, image_time: float, p_WP: np.ndarray) -> _Held:
        """The state after the action that is due now; `fault` is that of times and pusher."""
        time = context.get_time()
        told: dict[str, Any] = {"time": time, "image_age": time - image_time}
        held = replace(held, command_time=time, raw_action=())
        if not fault:
            image = np.asarray(self._rgb.Eval(context).data)
            fault = self._filter.image_fault(image.shape)
        if fault:
            return _with(held, self._filter.watch(held.safety, fault), limited=False, **told)
        images = (*held.images, image[..., :3].copy())[-self.spec.frames :]
        held = replace(held, images=images, image_time=image_time)
        stack = np.concatenate([images[0]] * (self.spec.frames - len(images)) + list(images), axis=2)
        try:
            d_W = np.asarray(self._bundle.act(stack, p_WP[self.spec.task.axis_indices]), float)
        except Exception as error:  # whatever it is, a robot is not to go on
            fault = f"policy failed: {type(error).__name__}: {error}"
            return _with(held, self._filter.watch(held.safety, fault), limited=False, **told)
        safety = self._filter.act(held.safety, d_W, p_WP)
        if d_W.shape == (self.spec.action_size,):
            held = replace(held, raw_action=tuple(d_W.tolist()))
        return _with(held, safety, actions=held.status.actions + 1, limited=safety.limited, **told)

    def _CalcVelocity(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._get(context).safety.v_WP)

    def _CalcRawAction(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._get(context).raw_action or np.full(self.spec.action_size, np.nan))

    def _CalcStatus(self, context: Context, output: AbstractValue) -> None:
        output.set_value(self._get(context).status)

    def _CalcCommandTime(self, context: Context, output: BasicVector) -> None:
        output.SetAtIndex(0, self._get(context).command_time)


def AddPolicyController(
    builder: DiagramBuilder, station: PushStation, bundle: Acting, limits: SafetyLimits
) -> PolicyController:
    """Adds a controller, disarmed, and connects it with a station of any engine.

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
        given = f"{setup.scenario.num_worlds} worlds, input {station.get_input_port().get_name()}"
        raise ParameterError(f"station: got {given}; allowed: one world, and command='velocity'")
    check_scene(bundle.spec, setup)
    controller = builder.AddNamedSystem("policy_controller", PolicyController(bundle, limits, setup.period))
    for name in ("rgb", "rgb_time", "pusher_state"):
        builder.Connect(station.GetOutputPort(name), controller.GetInputPort(name))
    builder.Connect(controller.GetOutputPort("pusher_velocity_W"), station.GetInputPort("pusher_velocity_W"))
    return controller


def _with(held: _Held, safety: Safety, **told: Any) -> _Held:
    """The controller's state with another one of the safety block, and the status that follows."""
    status = replace(held.status, state=safety.mode, reason=safety.reason, **told)
    return replace(held, safety=safety, status=status)
