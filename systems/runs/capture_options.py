"""The options of `pinwm capture simulate`, checked, and the scenario that they stand for."""

import dataclasses
import math
from dataclasses import dataclass
from typing import cast

from pinwm_drake.capture.scene import PUSHER_KINDS, PusherKind, PusherShape
from pinwm_drake.errors import ParameterError
from pinwm_drake.models import OBJECT_NAMES
from pinwm_drake.systems.runs.recorder import Rates
from pinwm_drake.systems.scenario.schema import Physics, Plant, Pusher, Scenario, Shape, Theta

_PUSHER_LENGTH = 0.06  # m, of the straight part of a capsule or cylinder
_COASTING = 0.012  # m
_GRAVITY = 9.81  # m/s^2
_SLOWEST, _FASTEST = 0.12, 0.4  # m/s, of a push whose speed is not given
_RECORD_RATE = 240.0  # Hz, the lowest of the pusher's log
_LONGEST_STEP = 1 / 3800  # s
_BOUNCING_STEPS = 2  # times more of them where an impact of some 3 ms is to keep its energy


@dataclass(frozen=True)
class SimulateOptions:
    """The options of `pinwm capture simulate`, named and in units as there.

    Raises:
        ParameterError: One is out of range.
    """

    object_name: str
    friction: float
    pusher_friction: float
    mass: float
    restitution: float
    seed: int
    size: int
    episodes: int
    static_views: int
    frames: int
    rate: float
    speed: float
    distance: float
    pusher: str
    pusher_radius: float
    lying: bool
    supersampling: int

    def __post_init__(self) -> None:
        """Checks them; those of the scenario within its bounds."""
        _require("--object", self.object_name, self.object_name in OBJECT_NAMES, ", ".join(OBJECT_NAMES))
        _require("--lying", self.lying, not self.lying or self.object_name == "mug", "with --object mug only")
        _require_quantity("--friction", self.friction, Theta, "friction_floor")
        _require_quantity("--pusher-friction", self.pusher_friction, Theta, "friction_pusher")
        _require_quantity("--mass", self.mass, Theta, "mass")
        _require_quantity("--restitution", self.restitution, Theta, "restitution")
        _require("--seed", self.seed, 0 <= self.seed < 2**63, "0 or more")
        _require("--size", self.size, 16 <= self.size <= 2048, "16 to 2048 px")
        _require("--episodes", self.episodes, 0 <= self.episodes <= 1000, "0 to 1000")
        _require("--static-views", self.static_views, 1 <= self.static_views <= 1000, "1 to 1000")
        _require("--frames", self.frames, 2 <= self.frames <= 10000, "2 to 10000")
        _require("--rate", self.rate, 1 <= self.rate <= 240, "1 to 240 Hz")
        _require("--speed", self.speed, 0.01 <= self.speed <= 0.5, "0.01 to 0.5 m/s")
        _require("--distance", self.distance, 0.005 <= self.distance <= 0.5, "0.005 to 0.5 m")
        _require("--pusher", self.pusher, self.pusher in PUSHER_KINDS, ", ".join(PUSHER_KINDS))
        _require_quantity("--pusher-radius", self.pusher_radius, Shape, "radius")
        _require("--supersampling", self.supersampling, 1 <= self.supersampling <= 8, "1 to 8")

    @property
    def rates(self) -> Rates:
        """How often what happens."""
        records = math.ceil(_RECORD_RATE / self.rate)
        steps = math.ceil(1 / (self.rate * records * _LONGEST_STEP))
        return Rates(self.rate, records, steps if self.restitution == 0 else _BOUNCING_STEPS * steps)

    @property
    def shape(self) -> PusherShape:
        """The pusher's."""
        kind = cast(PusherKind, self.pusher)
        return PusherShape(kind, self.pusher_radius, 0.0 if kind == "sphere" else _PUSHER_LENGTH)

    @property
    def scenario(self) -> Scenario:
        """What there is. The pusher may change its speed at every step of the plant, as a smooth motion does."""
        step = self.rates.time_step
        return Scenario(
            name=self.object_name,
            object=self.object_name,
            engine="hydroelastic",
            theta=Theta(self.mass, self.friction, self.pusher_friction, self.restitution),
            pusher=Pusher(shape=Shape(self.shape.kind, self.shape.radius, self.shape.length), period=step),
            physics=Physics(time_step=step),
            plant=Plant(time_step=step, reference_speed=self.speed),
            gravity=_GRAVITY,
            seed=self.seed,
        )


def coasting_speed(friction: float) -> float:
    """Speed of a pusher [m/s] after which an object coasts on by v^2 / 2 mu g = 12 mm: what shows its friction.

    An object that stops with the pusher shows only that its friction is large enough.
    """
    return min(max(math.sqrt(2 * max(friction, 0.0) * _GRAVITY * _COASTING), _SLOWEST), _FASTEST)


def _require(name: str, value: object, allowed: bool, range_in_words: str) -> None:
    if not allowed:
        raise ParameterError(f"{name}: got {value}; allowed: {range_in_words}")


def _require_quantity(name: str, value: float, schema: type, key: str) -> None:
    """Requires what a scenario requires of one of its keys."""
    about = next(field.metadata for field in dataclasses.fields(schema) if field.name == key)
    low, high, unit = about["low"], about["high"], about["unit"]
    _require(name, value, low <= value <= high, f"{low:g} to {high:g}" + ("" if unit == "1" else f" {unit}"))
