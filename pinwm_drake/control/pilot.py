# SPDX-License-Identifier: MIT
"""A policy's conduct from image to velocity, as a state that is passed on: frames, faults, limits, and the end."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import numpy as np

from pinwm_drake.control.image_rules import ImageRules, Sight
from pinwm_drake.control.safety_filter import HALTED, Mode, Safety, SafetyFilter
from pinwm_drake.errors import require
from pinwm_drake.learning.safety import SafetyLimits
from pinwm_drake.learning.spec import PolicySpec
from pinwm_drake.tasks.registry import recipe_of

_NEAR = 4  # actions in a row with the object at the goal by the policy's estimate, until it is taken for done
_SHARE = 0.8  # of the tolerances, as the estimate is some millimetres off
_CLOCK = 1e-6  # s, by which times may be off


class Acting(Protocol):
    """Policy in physical units, such as a bundle.

    One that has `step(image, p_WP)`, as `Bundle.step`, tells with it what it takes the state of its task for; one that
    has `mask_pixels` tells how many pixels the object has.
    """

    @property
    def spec(self) -> PolicySpec:
        """Specification of the policy, which observes "rgb"."""

    def act(self, image: np.ndarray, p_WP: np.ndarray) -> np.ndarray:
        """Return the translation d_W (n,) m of the pusher along the task's axes over the horizon, world.

        Args:
            image: (height, width, 3 k) uint8, RGB: the last k images, the oldest first.
            p_WP: (spec.pusher_size,) m, world: position of the pusher along the task's axes when the last image was
                taken; with a history what `PolicySpec.pusher_seen` lists after it.
        """


@dataclass(frozen=True)
class ControlStatus:
    """Status of a controller, and the reason for it.

    Attributes:
        state: "disarmed", "armed", "running", "latched" or "done"; see `Safety`.
        reason: The fault that latched it, the present one while disarmed, or the end of its task; empty where there is
            none.
        time: s, of the last action or change.
        image_age: s, age of the image at that time; NaN before the first.
        actions: Number of actions that the policy has computed since the last reset.
        limited: Flag: the limits changed the last action.
        estimate: Words on the policy's own estimate of the object, such as its distance from the goal.
    """

    state: Mode = "disarmed"
    reason: str = ""
    time: float = 0.0
    image_age: float = float("nan")
    actions: int = 0
    limited: bool = False
    estimate: str = ""


@dataclass(frozen=True, eq=False)
class Inputs:
    """Inputs of a controller at one moment.

    Attributes:
        time: s, now.
        image_time: s, when the last image was taken; -1 before the first.
        rgb: Function that gives the image, (height, width, 3 or more) uint8; called only where it is needed.
        pusher_time: s, when the pusher was where `pusher_state` says.
        pusher_state: (6,) p_WP [m], v_WP [m/s], world.
        fault: Fault that camera or robot tell of, in words; empty where there is none.
    """

    time: float
    image_time: float
    rgb: Callable[[], np.ndarray]
    pusher_time: float
    pusher_state: np.ndarray
    fault: str = ""


@dataclass(frozen=True, eq=False)
class Memory:
    """State of a controller.

    Attributes:
        safety: State of the safety block, with the velocity that is commanded.
        track: Times [s] and positions p_WP (3,) m, world, of the pusher, the oldest first.
        images: Last k images (height, width, 3) uint8, one an action, the oldest first.
        image_time: s, when the last of them was taken.
        sight: Record of the last image that was looked at; None before the first.
        past: Positions (n,) m before the last actions and translations (n,) m that were asked for, world, the newest
            first, at most `history` of them; none before the first action since it was armed.
        raw_action: (n,) m, world: the policy's translation; empty where there is none.
        state: The policy's estimate of its task's state; empty where it tells none.
        near: Number of actions in a row with the object at the goal by the estimate.
        moves: Number of actions that moved the pusher since it was armed.
        command_time: s, of the last action.
        status: Status that follows.
    """

    safety: Safety = field(default_factory=Safety)
    track: tuple[tuple[float, tuple[float, ...]], ...] = ()
    images: tuple[np.ndarray, ...] = ()
    image_time: float = -np.inf
    sight: Sight | None = None
    past: tuple[tuple[np.ndarray, np.ndarray], ...] = ()
    raw_action: tuple[float, ...] = ()
    state: tuple[float, ...] = ()
    near: int = 0
    moves: int = 0
    command_time: float = -1.0
    status: ControlStatus = field(default_factory=ControlStatus)


class Pilot:
    """Conduct of a policy within mandatory limits; every method takes a `Memory` and returns the next.

    Between actions it looks for faults (`look`); each horizon it acts (`act`): the policy sees the last k images, one
    an action, and where the pusher was when the last of them was taken. It ends by itself where the policy's own
    estimate of the object has been at the goal in four actions in a row, and after `max_steps` actions.

    Args:
        policy: Policy that observes "rgb".
        limits: Limits of the pusher's motion.
        live: Flag: images come from a real camera, so that each is looked at as it comes, and never is the same as
            the one before. Otherwise they are looked at only when the policy acts, as they may have to be drawn.

    Attributes:
        spec: Specification of the policy.

    Raises:
        ParameterError: There are no limits, or the policy is told its goal and has none.
    """

    def __init__(self, policy: Acting, limits: SafetyLimits, *, live: bool = False) -> None:
        spec = policy.spec
        require("goal", "none", not spec.task.goal_size, "a policy with one, as Bundle.toward gives it (--goal)")
        self.spec, self.limits, self._policy, self._live = spec, limits, policy, live
        self._filter = SafetyFilter(limits, spec.horizon, (spec.camera.height, spec.camera.width), spec.task)
        low, high = np.array([limits.box_low, limits.box_high])
        low[spec.task.axis_indices], high[spec.task.axis_indices] = spec.pusher_low, spec.pusher_high
        box = (float(low[0]), float(low[1])), (float(high[0]), float(high[1]))
        pixels = getattr(policy, "mask_pixels", None)
        self._rules = ImageRules(spec.camera, spec.pusher_height, box, limits.max_speed, pixels, live)

    def arm(self, memory: Memory, time: float) -> Memory:
        """Let the policy move the pusher from the next action on; raises StateError where it has to be reset first."""
        safety = self._filter.arm(memory.safety)
        begun = memory if memory.safety.mode == "running" else replace(memory, near=0, moves=0, past=())
        return _with(begun, safety, time=time)

    def disarm(self, memory: Memory, time: float) -> Memory:
        """Stop the pusher; a fault that latched, or the end of the task, stays."""
        return _with(memory, self._filter.disarm(memory.safety), time=time)

    def fail(self, memory: Memory, time: float, fault: str) -> Memory:
        """Take note of a fault [words] from outside, which latches while armed."""
        return _with(memory, self._filter.watch(memory.safety, fault), time=time)

    def look(self, memory: Memory, inputs: Inputs) -> Memory:
        """Look for faults between actions; the same object where nothing has changed."""
        recorded = self._recorded(memory, inputs)
        fault = self._fault(memory, inputs)
        if not fault and self._live:
            recorded, fault = self._looked_at(recorded, inputs)
        safety = self._filter.watch(memory.safety, fault)
        if safety == memory.safety:
            return recorded
        return _with(recorded, safety, time=inputs.time, image_age=inputs.time - inputs.image_time)

    def act(self, memory: Memory, inputs: Inputs) -> Memory:
        """Acts on the last image, or does nothing where there is a fault or the task is over."""
        told: dict[str, Any] = {"time": inputs.time, "image_age": inputs.time - inputs.image_time}
        fault = self._fault(memory, inputs)
        memory = replace(self._recorded(memory, inputs), command_time=inputs.time, raw_action=(), state=())
        if not fault:
            memory, fault = self._looked_at(memory, inputs)
        if not fault and inputs.image_time == memory.image_time:
            fault = f"image is repeated: none has come since that of {told['image_age']:.3f} s ago"
        if fault:
            return _with(memory, self._filter.watch(memory.safety, fault), limited=False, **told)
        if memory.moves >= self.spec.max_steps and memory.safety.mode == "running":
            over = self._filter.finish(memory.safety, f"{memory.moves} actions were made, as many as in training")
            return _with(memory, over, limited=False, **told)
        image = inputs.rgb()[..., :3].copy()
        images = (*memory.images, image)[-self.spec.frames :]
        memory = replace(memory, images=images, image_time=inputs.image_time)
        stack = np.concatenate([images[0]] * (self.spec.frames - len(images)) + list(images), axis=2)
        p_WP = self._pusher_at(memory, inputs.image_time)[self.spec.task.axis_indices]
        try:
            d_W, memory = self._decide(memory, stack, self._with_past(memory, p_WP))
        except Exception as error:  # whatever it is, a robot is not to go on
            fault = f"policy failed: {type(error).__name__}: {error}"
            return _with(memory, self._filter.watch(memory.safety, fault), limited=False, **told)
        told |= {"actions": memory.status.actions + 1, "estimate": self._words(memory)}
        if memory.near >= _NEAR:
            over = self._filter.finish(memory.safety, "at the goal, by the policy's estimate")
            if over.mode in HALTED:
                return _with(memory, over, limited=False, **told)
        safety = self._filter.act(memory.safety, d_W, np.asarray(inputs.pusher_state[:3], float))
        if d_W.shape == (self.spec.action_size,):
            memory = replace(memory, raw_action=tuple(d_W.tolist()))
        if safety.mode == "running":
            past = ((p_WP, d_W), *memory.past)[: self.spec.history]
            memory = replace(memory, moves=memory.moves + 1, past=past)
        return _with(memory, safety, limited=safety.limited, **told)

    def _with_past(self, memory: Memory, p_WP: np.ndarray) -> np.ndarray:
        """Position (n,) m with its history, (pusher_size,) m, as `PolicySpec.pusher_seen` has it."""
        first = memory.past[-1][0] if memory.past else p_WP
        missing = self.spec.history - len(memory.past)
        begun = [(first, np.zeros_like(p_WP))] * missing
        return np.concatenate([p_WP, *(part for pair in (*memory.past, *begun) for part in pair)])

    def _decide(self, memory: Memory, stack: np.ndarray, p_WP: np.ndarray) -> tuple[np.ndarray, Memory]:
        step = getattr(self._policy, "step", None)
        d_W, state = (self._policy.act(stack, p_WP), None) if step is None else step(stack, p_WP)
        known = () if state is None else tuple(np.asarray(state, float).tolist())
        near = bool(known) and bool(np.isfinite(known).all()) and self.spec.task.near_goal(np.array(known), _SHARE)
        return np.asarray(d_W, float), replace(memory, state=known, near=memory.near + 1 if near else 0)

    def _words(self, memory: Memory) -> str:
        task = self.spec.task
        return recipe_of(task).estimate_words(task, np.array(memory.state)) if memory.state else ""

    def _fault(self, memory: Memory, inputs: Inputs) -> str:
        late, longest = inputs.time - inputs.pusher_time, self.limits.max_image_age
        stale = f"pusher's state is stale: {late:.3f} s old; allowed: {longest:g} s" if late > longest + _CLOCK else ""
        last = memory.image_time
        known = self._filter.fault(inputs.time, inputs.image_time, inputs.pusher_state, last_image_time=last)
        return inputs.fault or known or stale

    def _looked_at(self, memory: Memory, inputs: Inputs) -> tuple[Memory, str]:
        """Return the memory with a record of the image, if that is a new one, and its fault in words."""
        if memory.sight is not None and inputs.image_time == memory.sight.time:
            return memory, ""
        image = np.asarray(inputs.rgb())
        if fault := self._filter.image_fault(image):
            return memory, fault
        sight = self._rules.sight(image[..., :3], inputs.image_time)
        moving = any(memory.safety.v_WP)
        return replace(memory, sight=sight), self._rules.fault(sight, memory.sight, moving)

    def _recorded(self, memory: Memory, inputs: Inputs) -> Memory:
        state = np.asarray(inputs.pusher_state, float)
        newer = not memory.track or inputs.pusher_time > memory.track[-1][0]
        if state.shape != (6,) or not np.isfinite(state).all() or not np.isfinite(inputs.pusher_time) or not newer:
            return memory
        oldest = inputs.time - self.limits.max_image_age - 2.0 * self.spec.horizon
        kept = tuple(entry for entry in memory.track if entry[0] >= oldest)
        return replace(memory, track=(*kept, (float(inputs.pusher_time), tuple(state[:3].tolist()))))

    @staticmethod
    def _pusher_at(memory: Memory, time: float) -> np.ndarray:
        """Position (3,) m of the pusher at a time [s], between those recorded; the nearest where it is outside them."""
        times = [entry[0] for entry in memory.track]
        places = np.array([entry[1] for entry in memory.track])
        return np.array([np.interp(time, times, column) for column in places.T])


def _with(memory: Memory, safety: Safety, **told: Any) -> Memory:
    status = replace(memory.status, state=safety.mode, reason=safety.reason, **told)
    return replace(memory, safety=safety, status=status)
