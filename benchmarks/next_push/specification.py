# SPDX-License-Identifier: MIT
"""The 24 captures: six objects in four engines, with what is to be tuned on and what nobody has looked at."""

import dataclasses
from dataclasses import dataclass
from typing import Literal

import numpy as np

from benchmarks.next_push.engines.rollout import Theta
from benchmarks.next_push.objects import OBJECTS, Thing
from pinwm_drake.capture.scene import PusherShape
from pinwm_drake.geometry.meshes import mass_properties
from pinwm_drake.systems.runs.realism.uneven import draw_unevenness

Split = Literal["tuning", "unseen"]
ENGINES = ("mujoco", "bullet", "hydroelastic", "point")
# Neither the other objects nor the engine of points are looked at while something is tuned.
_TUNING_OBJECTS, _TUNING_ENGINES = ("t", "l", "prism"), ("mujoco", "bullet", "hydroelastic")
# Captures whose pusher is an upright capsule; the others' is a sphere.
_CAPSULES = ("t_hydroelastic", "l_bullet", "prism_mujoco", "mug_point", "cube_mujoco", "cube_bullet")
_MASSES, _FRICTIONS_FLOOR, _FRICTIONS_PUSHER = (0.2, 1.0), (0.05, 0.5), (0.1, 0.6)
_RADIUS, _LENGTH = 0.010, 0.040  # m, of the pusher


@dataclass(frozen=True)
class CaptureSpec:
    """One of the captures.

    Attributes:
        name: Name of the capture, OBJECT_ENGINE.
        thing: One of `OBJECTS`.
        engine: One of `ENGINES`.
        split: Use of it.
        seed: Seed of theta, start pose, pushes and views.
        pusher: Kind of the pusher.
    """

    name: str
    thing: str
    engine: str
    split: Split
    seed: int
    pusher: Literal["sphere", "capsule"]

    @property
    def shape(self) -> PusherShape:
        """Shape of the pusher."""
        return PusherShape(self.pusher, _RADIUS, 0.0 if self.pusher == "sphere" else _LENGTH)

    def theta(self, thing: Thing) -> Theta:
        """Return the truth about the object, drawn from the seed: a uniform solid on an even face."""
        generator = np.random.default_rng([self.seed, 0])
        mass = generator.uniform(*_MASSES)
        floor, pusher = (np.exp(generator.uniform(*np.log(ends))) for ends in (_FRICTIONS_FLOOR, _FRICTIONS_PUSHER))
        solid = mass_properties(thing.mesh(), mass=mass)
        inertia = 0.5 * (solid.inertia + solid.inertia.T)
        return Theta(mass, float(floor), float(pusher), solid.p_com, inertia, np.zeros((0, 3)))


def _spec(number: int, thing: str, engine: str) -> CaptureSpec:
    name = f"{thing}_{engine}"
    split: Split = "tuning" if thing in _TUNING_OBJECTS and engine in _TUNING_ENGINES else "unseen"
    return CaptureSpec(name, thing, engine, split, 2000 + number, "capsule" if name in _CAPSULES else "sphere")


CAPTURES = tuple(
    _spec(number, thing, engine)
    for number, (engine, thing) in enumerate((engine, thing) for engine in ENGINES for thing in OBJECTS)
)


def uneven(thing: Thing, theta: Theta, generator: np.random.Generator) -> Theta:
    """Return the truth about an object whose mass is not spread evenly, and which stands on three or four places.

    Args:
        thing: The object.
        theta: The truth about it as a uniform solid on an even face.
        generator: Source of randomness.

    Returns:
        The same mass and frictions, with another centre of mass, the inertia that belongs to it, and feet.
    """
    found = draw_unevenness(thing.mesh(), thing.hulls, theta.mass, np.array([0.0, 0.0, 1.0]), generator)
    return dataclasses.replace(theta, p_com=found.p_com, inertia=found.inertia, feet=found.feet)
