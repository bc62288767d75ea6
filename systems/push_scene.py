"""What a pushing scene consists of, checked: object, floor, pusher, and the coefficients of their contacts."""

import math
from dataclasses import dataclass
from pathlib import Path

from pinwm_drake.capture.scene import PusherShape
from pinwm_drake.errors import ParameterError


@dataclass(frozen=True)
class PushScene:
    """An object on a floor, and a pusher.

    Attributes:
        mesh_path: The object's mesh, metres, watertight, frame O with its origin at the centre of mass.
        visual_path: What cameras see of it: an OBJ with normals for its faces and, maybe, an MTL.
        mass: kg, of uniform density.
        friction_floor: Coulomb coefficient of the pair object and floor, 0 or more.
        friction_pusher: Coulomb coefficient of the pair object and pusher, 0 or more.
        restitution: Of both pairs at `reference_speed`, 0 to 0.9; see `contact.dissipation_of`.
        pusher: Shape, its frame P in the middle, axis along z.
        gravity: m/s^2, along -z of the world.
        time_step: s.
        reference_speed: m/s, of approach, at which `restitution` is meant.

    Raises:
        ParameterError: A number is out of range; the message names it as on the command line.
    """

    mesh_path: Path
    visual_path: Path
    mass: float
    friction_floor: float
    friction_pusher: float
    restitution: float
    pusher: PusherShape
    gravity: float = 9.81
    time_step: float = 1 / 3840
    reference_speed: float = 0.12

    def __post_init__(self) -> None:
        """Checks the numbers."""
        _require("--mass", self.mass, 1e-3 <= self.mass <= 100, "0.001 to 100 kg")
        _require("--friction", self.friction_floor, 0 <= self.friction_floor <= 2, "0 to 2")
        _require("--pusher-friction", self.friction_pusher, 0 <= self.friction_pusher <= 2, "0 to 2")
        _require("--restitution", self.restitution, 0 <= self.restitution <= 0.9, "0 to 0.9")
        _require("--pusher-radius", self.pusher.radius, 0.003 <= self.pusher.radius <= 0.05, "0.003 to 0.05 m")
        _require("gravity", self.gravity, 0 < self.gravity < 100, "more than 0, below 100 m/s^2")
        _require("time step", self.time_step, 0 < self.time_step <= 1e-3, "more than 0, at most 0.001 s")
        _require("reference speed", self.reference_speed, 0 < self.reference_speed < math.inf, "more than 0 m/s")


def _require(name: str, value: float, allowed: bool, range_in_words: str) -> None:
    if not allowed:
        raise ParameterError(f"{name}: got {value:g}; allowed: {range_in_words}")
