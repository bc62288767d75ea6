# SPDX-License-Identifier: MIT
"""Requests of the demonstrations: what `pinwm demo` and `pinwm demo push` do."""

import dataclasses
from pathlib import Path
from typing import Annotated, Literal, get_args

from pinwm_drake.request import ADVANCED, FLATTEN, LAB, option, request

PusherShape = Literal["sphere", "capsule", "cylinder"]
PUSHER_SHAPES = get_args(PusherShape)


@request
class PushOptions:
    """One straight push of the T-block.

    Raises:
        ParameterError: An option is out of range.
    """

    friction: Annotated[float, option("Friction coefficient of block and floor.", ge=0)] = 0.03
    pusher_friction: Annotated[float, option("Friction coefficient of block and pusher.", ge=0)] = 0.1
    pusher: Annotated[PusherShape, option("Shape of the pusher.")] = "sphere"
    speed: Annotated[float, option("Speed of the pusher along y.", group=LAB, unit="m/s", gt=0, le=2)] = 0.15
    offset: Annotated[
        float,
        option("Offset of the contact from the centre of mass, sideways.", group=LAB, unit="m", ge=-0.05, le=0.05),
    ] = 0.01
    seconds: Annotated[
        float, option("Simulated duration; the pusher moves for 2/3 of it.", group=LAB, unit="s", gt=0, le=60)
    ] = 2.4
    time_step: Annotated[
        float, option("Time step of the physics.", group=ADVANCED, unit="s", gt=0, le=0.02, default="1/240")
    ] = 1 / 240

    @property
    def steps_per_record(self) -> int:
        """Time steps between two recorded states: about 60 records a second."""
        return max(1, round(1 / (60 * self.time_step)))

    @property
    def records(self) -> int:
        """Recorded states after the first one; at least one."""
        return max(1, round(self.seconds / (self.time_step * self.steps_per_record)))


@request
class PushRequest:
    """Request of a demonstration push and its folder."""

    options: Annotated[PushOptions, FLATTEN] = dataclasses.field(default_factory=PushOptions)
    out: Annotated[
        Path, option("Folder for trajectory.csv, push.png and push.mp4.", "--out", "-o", result="inside")
    ] = Path("out/push")
