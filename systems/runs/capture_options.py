# SPDX-License-Identifier: MIT
"""The request of a simulated capture: what `pinwm capture simulate` does. Light, as the command line reads it."""

import dataclasses
from pathlib import Path
from typing import Annotated, Literal

from pinwm_drake.errors import require
from pinwm_drake.models import OBJECT_NAMES
from pinwm_drake.request import ADVANCED, DATA, FLATTEN, LAB, argument, option, request
from pinwm_drake.tasks import DEFAULT_TASK

_FRICTION = {"ge": 0, "le": 2}


@request
class SimulateOptions:
    """A capture to be simulated.

    Raises:
        ParameterError: An option is out of range.
    """

    object_name: Annotated[
        str, option("Object that ships, such as mug.", "--object", allowed=", ".join(OBJECT_NAMES))
    ] = "t_block"
    task: Annotated[str, option("Task whose motion is filmed: push, or flip for pokes that rock the object.")] = (
        DEFAULT_TASK
    )
    lying: Annotated[bool, option("Lay the mug on its side.")] = False
    episodes: Annotated[int, option("Number of pushes from one pose of the object.", group=DATA, ge=0, le=1000)] = 2
    static_views: Annotated[int, option("Number of images of the object at rest.", group=DATA, ge=1, le=1000)] = 24
    frames: Annotated[int, option("Number of images of each push.", group=DATA, ge=2, le=10_000)] = 48
    rate: Annotated[float, option("Frame rate of the camera.", group=DATA, unit="Hz", ge=1, le=240)] = 24.0
    size: Annotated[int, option("Width and height of the images.", group=DATA, unit="px", ge=16, le=2048)] = 400
    forces: Annotated[bool, option("Log the force on the pusher, so that it tells the mass.", group=DATA)] = False
    friction: Annotated[float, option("Friction coefficient of object and floor.", group=LAB, **_FRICTION)] = 0.03
    pusher_friction: Annotated[
        float | None, option("Friction coefficient of object and pusher.", group=LAB, default="--friction", **_FRICTION)
    ] = None
    mass: Annotated[float, option("Mass of the object.", group=LAB, unit="kg", ge=1e-3, le=100)] = 1.0
    restitution: Annotated[
        float, option("Restitution; values above 0 are met only roughly.", group=LAB, ge=0, le=0.9)
    ] = 0.0
    speed: Annotated[
        float | None,
        option("Speed of the pusher.", group=LAB, unit="m/s", ge=0.01, le=1, default="the object coasts on by 12 mm"),
    ] = None
    rise: Annotated[
        tuple[float, float],
        option(
            "Smallest and largest slope of a poke.",
            group=LAB,
            unit="rad",
            metavar="MIN MAX",
            allowed="0 to 1.4 rad, the least first",
        ),
    ] = (0.3, 0.8)
    distance: Annotated[
        float, option("Distance that the pusher moves after the first contact.", group=LAB, unit="m", ge=0.005, le=0.5)
    ] = 0.10
    pusher: Annotated[Literal["sphere", "capsule", "cylinder"], option("Shape of the pusher.", group=LAB)] = "sphere"
    pusher_radius: Annotated[float, option("Radius of the pusher.", group=LAB, unit="m", ge=0.003, le=0.05)] = 0.01
    realistic: Annotated[
        bool, option("Lab conditions: uneven object, one lamp, blur, ragged masks, small offsets.", group=LAB)
    ] = False
    stand_in: Annotated[bool, option("Object, light and camera of `pinwm evaluate --stand-in`.", group=LAB)] = False
    supersampling: Annotated[
        int, option("Number of rendered pixels along each side of an image pixel.", group=ADVANCED, ge=1, le=8)
    ] = 3
    seed: Annotated[
        int, option("Seed of places, pushes and cameras.", group=ADVANCED, ge=0, lt=2**63, allowed="0 or more")
    ] = 0

    def __post_init__(self) -> None:
        """Check names, and options that depend on each other."""
        from pinwm_drake.tasks.registry import task_names

        require("--task", self.task, self.task in task_names(), ", ".join(task_names()))
        require("--object", self.object_name, self.object_name in OBJECT_NAMES, ", ".join(OBJECT_NAMES))
        require("--lying", self.lying, not self.lying or self.object_name.startswith("mug"), "with a mug only")
        low, high = self.rise
        require("--rise", f"{low} to {high}", 0.0 <= low <= high <= 1.4, "0 to 1.4 rad, the least first")

    @property
    def in_a_lab(self) -> bool:
        """Flag: nothing is as well known as Drake has it."""
        return self.realistic or self.stand_in


@request
class SimulateCaptureRequest:
    """Request of a simulated capture and its folder."""

    out: Annotated[Path, argument("Folder of the capture, new or empty.", "OUT", result="beside")]
    options: Annotated[SimulateOptions, FLATTEN] = dataclasses.field(default_factory=SimulateOptions)
