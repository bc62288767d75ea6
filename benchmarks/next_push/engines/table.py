"""Engines by name; each is imported when it is asked for, as MuJoCo and Bullet may not be installed."""

import importlib
from collections.abc import Callable
from typing import cast

import numpy as np
from pydrake.math import RigidTransform

from benchmarks.next_push.engines.rollout import Rollout, Theta
from benchmarks.next_push.objects import Thing
from benchmarks.next_push.pushes import Push

RollOut = Callable[[Thing, Theta, RigidTransform, Push | None, np.ndarray], Rollout]
_WHERE = {
    "mujoco": ("mujoco", "roll_out"),
    "bullet": ("bullet", "roll_out"),
    "hydroelastic": ("drake", "hydroelastic"),
    "point": ("drake", "point"),
}


def engine(name: str) -> RollOut:
    """Function that rolls out a push in an engine, one of "mujoco", "bullet", "hydroelastic" and "point"."""
    module, function = _WHERE[name]
    return cast(RollOut, getattr(importlib.import_module(f"benchmarks.next_push.engines.{module}"), function))
