# SPDX-License-Identifier: MIT
"""The safety block between a policy and a robot: faults, a latch, and limits; plain numpy, without Drake."""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from pinwm_drake.control.velocity_limiter import VelocityLimiter
from pinwm_drake.errors import StateError, require
from pinwm_drake.learning.safety import SafetyLimits
from pinwm_drake.tasks.task import Task

Mode = Literal["disarmed", "armed", "running", "latched", "done"]
HALTED = ("latched", "done")  # modes that only a reset ends
_STILL = (0.0, 0.0, 0.0)
_CLOCK = 1e-6  # s, by which an image may be from the future


@dataclass(frozen=True)
class Safety:
    """State of the safety block.

    Attributes:
        mode: "disarmed": nothing moves; "armed": the next action will move; "running": an action does; "latched":
            there was a fault, and nothing moves until a reset; "done": the task is over, and nothing moves either.
        reason: The fault that latched, the present one while disarmed, or the end of the task; empty where there is
            none.
        v_WP: (3,) m/s, world: the velocity commanded; zero unless running.
        limited: Flag: the limits changed the policy's velocity.
    """

    mode: Mode = "disarmed"
    reason: str = ""
    v_WP: tuple[float, float, float] = _STILL
    limited: bool = False


class SafetyFilter:
    """Filter that lets a policy's translations through as velocities, within limits, until the first fault.

    A fault is an image that is stale, from the future, older than the last or of another size, a pusher whose state is
    lost (not finite) or which is outside of its box, or an action that is not finite or of another shape. While armed,
    it latches: the velocity is zero at once, without regard to the acceleration, and stays so until a reset. While
    disarmed, it is only told.

    The filter itself has no state, so that a Drake Context can hold it: methods take a `Safety` and return the next.

    Args:
        limits: Limits: box, speed, acceleration, and age of images.
        horizon: s, between actions.
        image_size: Height and width, px, of images.
        task: Axes of the actions.

    Raises:
        ParameterError: There are no limits, or the horizon is not positive.
    """

    def __init__(self, limits: SafetyLimits, horizon: float, image_size: tuple[int, int], task: Task) -> None:
        require("limits", f"a {type(limits).__name__}", isinstance(limits, SafetyLimits), "SafetyLimits")
        self.limits, self.horizon, self._size, self._task = limits, horizon, image_size, task
        self._limiter = VelocityLimiter(limits, horizon)
        self._low, self._high = np.array(limits.box_low), np.array(limits.box_high)

    def arm(self, safety: Safety) -> Safety:
        """Next state of a safety block whose next action may move the pusher; no change while running.

        Raises:
            StateError: The safety block is latched, or the task is over.
        """
        if safety.mode in HALTED:
            how = "was stopped by a fault" if safety.mode == "latched" else "is done"
            raise StateError(f"arm: the controller {how} ({safety.reason}); reset it first")
        return safety if safety.mode == "running" else Safety("armed")

    def disarm(self, safety: Safety) -> Safety:
        """Next state of a safety block that stops at once; one that is latched or done stays as it is."""
        return safety if safety.mode in HALTED else Safety()

    def finish(self, safety: Safety, reason: str) -> Safety:
        """Next state of a safety block whose task is over for a reason; disarmed or latched, it stays as it is."""
        return Safety("done", reason) if safety.mode in ("armed", "running") else safety

    def fault(
        self, time: float, image_time: float, pusher_state: np.ndarray, *, last_image_time: float = -np.inf
    ) -> str:
        """Fault of the inputs, but for the image itself, in words; empty if there is none.

        Args:
            time: s, now.
            image_time: s, when the image was taken.
            pusher_state: (6,) p_WP [m], v_WP [m/s], world.
            last_image_time: s, when the image before it was taken.
        """
        state, longest = np.asarray(pusher_state, float), self.limits.max_image_age
        if state.shape != (6,) or not np.isfinite(state).all():
            return f"pusher's state is lost: {_shown(state)}"
        out = float(np.maximum(np.maximum(self._low - state[:3], state[:3] - self._high), 0.0).max())
        if out > self.limits.box_tolerance:
            return f"pusher is {1e3 * out:.1f} mm outside of its box, at {_shown(state[:3])} m"
        age = time - image_time
        if not np.isfinite(age):
            return f"image's time is not finite: {image_time}"
        if age > longest + _CLOCK:
            return f"image is stale: {age:.3f} s old; allowed: {longest:g} s"
        if age < -_CLOCK:
            return f"image is from the future: {-age:.6f} s ahead"
        if image_time < last_image_time:
            return f"image is {last_image_time - image_time:.6f} s older than the last one; a new episode needs a reset"
        return ""

    def image_fault(self, image: np.ndarray) -> str:
        """Fault of an image's size or type, in words; empty if it is (height, width, 3 or 4) uint8."""
        (height, width), shape = self._size, image.shape
        if len(shape) == 3 and shape[:2] != self._size:
            return f"image has {shape[1]} by {shape[0]} px; allowed: {width} by {height}"
        if len(shape) != 3 or shape[2] not in (3, 4) or image.dtype != np.uint8:
            return f"image is {image.dtype} {shape}; allowed: uint8 ({height}, {width}, 3 or 4)"
        return ""

    def watch(self, safety: Safety, fault: str) -> Safety:
        """Next state between actions, with a fault in words, or without ("")."""
        if safety.mode in HALTED:
            return safety
        if safety.mode == "disarmed":
            return replace(safety, reason=fault)
        return Safety("latched", fault) if fault else safety

    def act(self, safety: Safety, d_W: np.ndarray, p_WP: np.ndarray) -> Safety:
        """Next state with an action.

        Args:
            safety: Present state, when the inputs have no fault.
            d_W: (n,) m, world: the policy's translation along the task's axes; of any values and shape.
            p_WP: (3,) m, world: position of the pusher; finite.
        """
        fault = self.action_fault(d_W)
        if fault or safety.mode in ("disarmed", *HALTED):
            return self.watch(safety, fault)
        wanted = self._task.along_axes(np.asarray(d_W)) / self.horizon
        v_WP = self._limiter.limit(wanted, np.array(safety.v_WP), p_WP)
        x, y, z = (float(value) for value in v_WP)
        return Safety("running", "", (x, y, z), bool((v_WP != wanted).any()))

    def action_fault(self, d_W: np.ndarray) -> str:
        """Fault of an action d_W [m], which should be (n,), in words; empty if there is none."""
        if np.shape(d_W) != (shape := (self._task.action_size,)):
            return f"action has shape {np.shape(d_W)}; allowed: {shape}"
        with np.errstate(over="ignore"):
            finite = np.isfinite(np.divide(d_W, self.horizon)).all()
        return "" if finite else f"action is not finite: {_shown(d_W)} m"


def _shown(values: np.ndarray) -> str:
    return "[" + ", ".join(f"{value:.4g}" for value in np.ravel(values)) + "]"
