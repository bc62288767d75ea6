"""Options of a demonstration push, checked."""

import math
from dataclasses import dataclass

from pinwm_drake.errors import require

PUSHER_SHAPES = ("sphere", "capsule", "cylinder")
_HALF_BAR = 0.05  # half the length of the face that is pushed [m]


@dataclass(frozen=True)
class PushOptions:
    """One straight push of the T-block.

    Attributes:
        friction: Friction coefficient of block and floor, 0 or more.
        pusher_friction: Friction coefficient of block and pusher, 0 or more.
        speed: Speed of the pusher along +y [m/s].
        offset: x at which it moves [m]; the block's centre of mass is at 0.
        seconds: Simulated time [s].
        time_step: [s].
        pusher: One of `PUSHER_SHAPES`.
    """

    friction: float
    pusher_friction: float
    speed: float
    offset: float
    seconds: float
    time_step: float
    pusher: str

    def __post_init__(self) -> None:
        """Checks every option.

        Raises:
            ParameterError: When one is outside its range, named as on the command line.
        """
        require("--friction", self.friction, 0 <= self.friction < math.inf, "0 or more")
        require("--pusher-friction", self.pusher_friction, 0 <= self.pusher_friction < math.inf, "0 or more")
        require("--speed", self.speed, 0 < self.speed <= 2, "more than 0, at most 2 m/s")
        require("--offset", self.offset, abs(self.offset) <= _HALF_BAR, f"-{_HALF_BAR} to {_HALF_BAR} m")
        require("--seconds", self.seconds, 0 < self.seconds <= 60, "more than 0, at most 60 s")
        require("--time-step", self.time_step, 0 < self.time_step <= 0.02, "more than 0, at most 0.02 s")
        require("--pusher", self.pusher, self.pusher in PUSHER_SHAPES, ", ".join(PUSHER_SHAPES))

    @property
    def steps_per_record(self) -> int:
        """Time steps between two recorded states: about 60 records a second."""
        return max(1, round(1 / (60 * self.time_step)))

    @property
    def records(self) -> int:
        """Recorded states after the first one; at least one."""
        return max(1, round(self.seconds / (self.time_step * self.steps_per_record)))
