# SPDX-License-Identifier: MIT
"""Engines that push objects: MuJoCo, Bullet, and Drake's two contact models.

Each is imported when it is asked for, as MuJoCo and Bullet may not be installed.
"""

import importlib
from collections.abc import Callable
from functools import partial

import numpy as np
from pydrake.math import RigidTransform

from benchmarks.next_push.engines.rollout import EngineScene, Rollout, Theta, Tip
from benchmarks.next_push.objects import Thing
from benchmarks.next_push.pushes import Push

RollOut = Callable[[Thing, Theta, RigidTransform, Push | None, np.ndarray], Rollout]
MakeScene = Callable[[Thing, Theta, RigidTransform, Tip | None], EngineScene]


def scene_maker(name: str) -> MakeScene:
    """Maker of scenes in an engine, one of "mujoco" and "bullet"."""
    maker: MakeScene = importlib.import_module(f"benchmarks.next_push.engines.{name}").PokedScene
    return maker


def engine(name: str) -> RollOut:
    """Return the function that rolls out a push in an engine, one of "mujoco", "bullet", "hydroelastic" and "point".

    Its arguments are the object, the truth about it, its pose X_WO at first, at rest, the push or None for no pusher,
    and times (n,) s, increasing from 0, multiples of 1 / `LOG_RATE`.
    """
    if name in ("hydroelastic", "point"):
        from benchmarks.next_push.engines.drake import roll_out

        return partial(roll_out, name)

    def rolled(thing: Thing, theta: Theta, X_WO: RigidTransform, push: Push | None, t: np.ndarray) -> Rollout:
        motion = None if push is None else push.motion
        tip = None if push is None else Tip(push.shape, push.motion.p_WP, push.motion.direction_W[None])
        return scene_maker(name)(thing, theta, X_WO, tip).roll_out(t, motion)

    return rolled
