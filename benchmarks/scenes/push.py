# SPDX-License-Identifier: MIT
"""Push that every engine performs: T-block, floor, pusher. The engines are in `*_scene.py`.

The block (bar 100 x 40 mm, stem 40 x 100 mm, 50 mm thick, 1 kg) rests on the floor, its centre of mass at the
origin and the bar towards +y. The pusher starts in touch with the middle of the bar's long side, 1 mm off the
centre line, and moves along -y at 0.15 m/s. So close to the line of the centre of mass the block turns slowly
and the pusher stays on it for the whole rollout (0.2 m); each engine counts its contacts to prove it.
"""

import numpy as np

MASS = 1.0  # kg
BAR_SIZE = (0.10, 0.04, 0.05)  # m
STEM_SIZE = (0.04, 0.10, 0.05)  # m
BAR_CENTER = (0.0, 0.035, 0.0)  # m, from the centre of mass: bar and stem weigh the same and are 70 mm apart
STEM_CENTER = (0.0, -0.035, 0.0)
BLOCK_HEIGHT = 0.025  # m, centre of mass above the floor
FRICTION = 0.03  # of both pairs, object-floor and object-pusher

TIME_STEP = 1.0 / 240.0  # s
SUBSTEPS = 10  # steps a frame
FRAMES = 32
STEPS = FRAMES * SUBSTEPS  # 320

SPEED = 0.15  # m/s
OFFSET = 0.001  # m, along x
RADIUS = 0.010  # m, of each pusher
LENGTH = 0.040  # m, of the cylindrical part of capsule and cylinder (axis vertical)
PUSHERS = ("sphere", "capsule", "cylinder")


def pusher_start(pusher: str) -> tuple[float, float, float]:
    """Centre of the pusher at the start, in metres, world frame: touching the bar, clear of the floor."""
    height = 0.025 if pusher == "sphere" else 0.035
    return (OFFSET, BAR_CENTER[1] + BAR_SIZE[1] / 2 + RADIUS, height)


def block_inertia() -> np.ndarray:
    """Principal moments (3,) of the block about its centre of mass, in kg m^2, uniform density."""
    moments = np.zeros(3)
    for size, center in ((BAR_SIZE, BAR_CENTER), (STEM_SIZE, STEM_CENTER)):
        x2, y2, z2 = np.square(size)
        moments += MASS / 2 * np.array([y2 + z2, x2 + z2, x2 + y2]) / 12
        moments += MASS / 2 * np.array([1.0, 0.0, 1.0]) * center[1] ** 2  # Steiner; the offset is along y
    return moments
