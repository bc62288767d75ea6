# SPDX-License-Identifier: MIT
"""A small twin: a cube with a few surfels, and a capsule that pushes it."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from pinwm_drake.capture.episodes import PusherTrajectory
from pinwm_drake.capture.scene import PusherGeometry, PusherShape
from pinwm_drake.scene import pusher_motion, step_count
from pinwm_drake.spatial.poses import Pose
from pinwm_drake.twin.rollout import pusher_impulses, resting_start, twin_parameters, twin_scene
from pinwm_drake.twin.twin import THETA, Estimate, Twin
from tests.capture.cube import SIDE, write_mesh
from tests.rendering.scenes import cloud

MASS = 0.2  # kg
VALUES = {"mass": MASS, "friction_floor": 0.3, "friction_pusher": 0.2, "restitution_floor": 0.0}
VALUES |= {"restitution_pusher": 0.1}


def estimates(**values: float) -> dict[str, Estimate]:
    """The physical parameters of the cube; `values` replace some, without an interval."""
    moment = MASS * SIDE**2 / 6
    nominal = VALUES | {key: moment for key in THETA if key.startswith("inertia")}
    found = {}
    for key, unit in THETA.items():
        value = values.get(key, nominal[key])
        interval = None if key in values else (0.9 * value, 1.1 * value)
        found[key] = Estimate(value, interval, key == "friction_floor", unit)
    return found


def weighing(twin: Twin, factor: float) -> Twin:
    """A twin with mass and moments of inertia times a factor."""
    names = [name for name in THETA if name.startswith(("mass", "inertia"))]
    return replace(
        twin,
        theta=twin.theta | {name: replace(twin.theta[name], value=factor * twin.theta[name].value) for name in names},
    )


def cube_twin(folder: Path, **fields) -> Twin:
    """A twin whose mesh lies in `folder`; `fields` replace some of its own."""
    given = {
        "name": "cube",
        "mesh_path": write_mesh(folder / "cube.obj"),
        "pusher": PusherGeometry(None, PusherShape("capsule", 0.01, 0.04)),
        "gravity": 9.81,
        "floor_height": 0.0,
        "time_step": 1 / 240,
        "support": "corners",
        "theta": estimates(),
        "nuisance": {"lift": Estimate(1e-3, (5e-4, 1.5e-3), True, "m", "the object stands on a margin")},
        "camera_offset": (0.25, -0.5),
        "surfels": cloud(),
        "provenance": {"capture": "/somewhere", "episode": "1e3", "seeds": [0, 1], "loss": 1e-5},
    }
    return Twin(**(given | fields))


def pusher_force(twin: Twin, X_WO: Pose, trajectory: PusherTrajectory, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Times (T + 1,) [s] of the physics' steps from t[0] to t[-1], and the mean force on the pusher in each."""
    scene = twin_scene(twin, X_WO.q)
    h, first, start = scene.model.time_step, float(t[0]), resting_start(scene, X_WO)
    steps = step_count(float(t[-1]) - first, h)
    motion = pusher_motion(trajectory, first, steps, h)
    impulses = pusher_impulses(scene, twin_parameters(twin, scene), Pose(start.q[None], start.p[None]), motion)
    return first + h * np.arange(steps + 1), impulses[:, 0] / h
