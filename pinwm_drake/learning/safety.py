# SPDX-License-Identifier: MIT
"""Limits of a controller's motion of the pusher: the part of a policy's contract that keeps a robot whole."""

import math
from dataclasses import asdict, dataclass
from typing import Annotated, Any

import numpy as np
from pydantic import Field
from pydantic_core import to_jsonable_python

from pinwm_drake.errors import ParameterError
from pinwm_drake.learning.spec import PolicySpec
from pinwm_drake.validation import check_fields, from_document

_UNITS = {"max_speed": "m/s", "max_acceleration": "m/s^2"}
_Positive = Annotated[float, Field(gt=0, json_schema_extra={"allowed": "a finite number, more than 0"})]
_Corner = Annotated[tuple[float, float, float], Field(json_schema_extra={"allowed": "three finite numbers, m"})]
_COMMAND_AGE = 0.25  # s, two actions of 0.1 s and a half
_HALF_HEIGHT = 0.01  # m, half the default box's size along axes that the task does not move


@dataclass(frozen=True)
class SafetyLimits:
    """Limits of a pusher's motion; all of them finite, so that there is no controller without.

    Attributes:
        box_low, box_high: (3,) m, world: corners of the box that the pusher's point P stays in.
        max_speed: m/s, largest norm of the commanded velocity.
        max_acceleration: m/s^2, largest norm of its change per time. Only a fault, and a pusher that something else
            took to the edge of its box, may be stopped in less.
        max_image_age: s, age beyond which an image is stale.
        box_tolerance: m, distance up to which the pusher may be outside of the box before that is a fault.
        max_command_age: s; when no velocity has come for longer, the driver of a robot slows down to rest.
        max_lag: m, largest distance of a robot from its commanded place; beyond it, it is led no farther away.

    Raises:
        ParameterError: A value is not finite, or not positive, or the box is empty.
    """

    box_low: _Corner
    box_high: _Corner
    max_speed: _Positive
    max_acceleration: _Positive
    max_image_age: _Positive
    box_tolerance: _Positive = 0.005
    max_command_age: _Positive = _COMMAND_AGE
    max_lag: _Positive = 0.03

    def __post_init__(self) -> None:
        check_fields(self)
        if not all(low < high for low, high in zip(self.box_low, self.box_high, strict=True)):
            raise ParameterError(
                f"box_low, box_high: got {list(self.box_low)}, {list(self.box_high)} m; allowed: low below high"
            )

    def to_document(self) -> dict[str, Any]:
        """Return the limits as plain data, for YAML."""
        document: dict[str, Any] = to_jsonable_python(asdict(self))
        return document

    def shortfall(self, robot: "SafetyLimits") -> str:
        """Shortfall of a robot with such limits, as "max_acceleration: 4 of 20 m/s^2"; "" for none."""
        pairs = [(name, unit, getattr(robot, name), getattr(self, name)) for name, unit in _UNITS.items()]
        return ", ".join(f"{name}: {has:g} of {wants:g} {unit}" for name, unit, has, wants in pairs if has < wants)

    @classmethod
    def from_document(cls, document: Any) -> "SafetyLimits":
        """Limits that `to_document` described; every one has to be there, so that none is taken for granted.

        Raises:
            ParameterError: A key is missing or unknown, or a value is out of range.
        """
        return from_document(cls, document, "limits")


def default_limits(spec: PolicySpec) -> SafetyLimits:
    """Limits that let a policy do what it did in training: its own speed and box, and to turn round between actions.

    The box is that of the policy along its task's axes, and 10 mm to either side of where the pusher is along the other
    ones; the velocity may change from one way at full speed to the other within an action, or as fast as in training
    where that is slower; an image is stale after two actions, which leaves room for a camera of 20 Hz that is 80 ms
    late.

    Args:
        spec: Specification of the policy.
    """
    speed, still = round(spec.max_translation / spec.horizon, 9), np.array([0.0, 0.0, spec.pusher_height])
    low, high = still - _HALF_HEIGHT, still + _HALF_HEIGHT
    low[spec.task.axis_indices], high[spec.task.axis_indices] = spec.pusher_low, spec.pusher_high
    return SafetyLimits(
        box_low=tuple(low),
        box_high=tuple(high),
        max_speed=speed,
        max_acceleration=min(spec.acceleration or math.inf, 2 * speed / spec.horizon),
        max_image_age=2 * spec.horizon,
        max_command_age=max(_COMMAND_AGE, 2.5 * spec.horizon),
    )
