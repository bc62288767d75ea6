# SPDX-License-Identifier: MIT
"""Pushes of a capture: four, at different sides of the object, off its middle, at speeds that know no friction."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import trimesh

from pinwm_drake.capture.pusher import pushing_height
from pinwm_drake.capture.scene import PusherShape
from pinwm_drake.geometry.meshes import mass_properties
from pinwm_drake.systems.pusher.choice import choose_push
from pinwm_drake.systems.pusher.motion import StraightPush

_SPEEDS = (0.05, 0.3)  # m/s, drawn evenly by their logarithm
_DISTANCES = (0.060, 0.110)  # m, after the object is met
_LONGEST = 1.75  # s, of a motion: slow pushes are shorter
_SHORTEST = 0.05  # m
_HEIGHTS = (0.5, 1.0)  # of the height of the centre of mass
_HIGHEST = 0.030  # m, above the floor: higher ones could tip an object
_SIDEWAYS = 0.005  # m, between the middle and the line of the push, at least
_SECTOR = math.radians(35)  # to each side of the direction that a push is meant to have
_ATTEMPTS = 200
_STEADY, _CANDIDATES = 3.0, 5
_FREE = 0.012  # m, from start to touch: `choose_push` has it so
_AFTERWARDS = 0.30  # s, of video after the pusher stops
FRAME_RATE = 24  # Hz
_FRAMES = (32, 48)


@dataclass(frozen=True, eq=False)
class Push:
    """Push of a capture, and how long it is filmed.

    Attributes:
        shape: Shape of the pusher, upright.
        motion: Its straight motion from rest to rest.
        frames: Number of pictures that are taken of it.
    """

    shape: PusherShape
    motion: StraightPush
    frames: int


def draw_pushes(
    mesh_W: trimesh.Trimesh,
    shape: PusherShape,
    generator: np.random.Generator,
    number: int = 4,
    *,
    amplification: Callable[[Push], float] = lambda push: 0.0,
) -> list[Push]:
    """Draws the pushes of a capture.

    Args:
        mesh_W: The object at rest, m, world; the floor is at 0.
        shape: Shape of the pusher.
        generator: Source of randomness.
        number: Number of pushes; their directions are spread evenly.
        amplification: Function that tells by what a push amplifies a start a little aside. Of the few pushes that are
            tried of a direction, the first that amplifies by less than three is taken, else the one that does least.

    Returns:
        The pushes. Speed is log-uniform in 0.05 to 0.3 m/s, the way after the touch 60 to 110 mm (less at the slowest).

    Raises:
        ParameterError: The pusher finds no side of the object at its height.
        RuntimeError: No push of a wanted direction was found.
    """
    p_com = mass_properties(mesh_W, mass=1.0).p_com
    first = generator.uniform(-math.pi, math.pi)
    pushes = []
    for k in range(number):
        wanted = first + 2 * math.pi * k / number
        speed = math.exp(generator.uniform(*np.log(_SPEEDS)))
        longest = max(speed * _LONGEST - _FREE, _SHORTEST)
        distance = min(generator.uniform(*_DISTANCES), longest)
        height = pushing_height(shape, 0.0, min(generator.uniform(*_HEIGHTS) * p_com[2], _HIGHEST))
        found: list[tuple[float, Push]] = []
        for _ in range(_ATTEMPTS):
            motion = choose_push(mesh_W, p_com, shape, generator, height=height, speed=speed, distance=distance)
            if not _fits(motion, p_com, wanted):
                continue
            frames = math.ceil((motion.end_time + _AFTERWARDS) * FRAME_RATE) + 1
            push = Push(shape, motion, int(np.clip(frames, *_FRAMES)))
            found.append((amplification(push), push))
            if found[-1][0] < _STEADY or len(found) == _CANDIDATES:
                break
        if not found:
            raise RuntimeError(f"no push towards {math.degrees(wanted):.0f} degrees")
        push = min(found, key=lambda one: one[0])[1]
        pushes.append(push)
    return pushes


def _fits(motion: StraightPush, p_com: np.ndarray, wanted: float) -> bool:
    """Flag: a motion has the wanted direction [rad] and passes beside the centre of mass (3,) [m]."""
    x, y = motion.direction_W[:2]
    turn = (math.atan2(y, x) - wanted + math.pi) % (2 * math.pi) - math.pi
    offset = float((motion.p_WP - p_com)[:2] @ [-y, x])
    return abs(turn) < _SECTOR and abs(offset) > _SIDEWAYS
