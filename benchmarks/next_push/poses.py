# SPDX-License-Identifier: MIT
"""Poses of a capture, without pictures: its pushes rolled out by its engine, and a file that keeps them."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.math import RigidTransform, RotationMatrix

from benchmarks.next_push.engines import engine
from benchmarks.next_push.engines.rollout import FLOOR_HEIGHT, LOG_RATE, Rollout, Theta, log_times, rigid
from benchmarks.next_push.objects import Thing
from benchmarks.next_push.pushes import FRAME_RATE, Push, draw_pushes
from benchmarks.next_push.specification import CaptureSpec
from pinwm_drake.capture.scene import PusherShape
from pinwm_drake.files import prepare_folder, replacing
from pinwm_drake.systems.pusher.motion import StraightPush
from pinwm_drake.systems.runs.recorder import quaternions
from pinwm_drake.systems.scenario.start import on_floor

_SETTLING_TIME = 0.5  # s
# Starts this far aside [m, rad] tell which pushes nobody could predict: no camera sees a start better.
_ASIDE = (5e-4, np.radians(0.5))
PER_FRAME = LOG_RATE // FRAME_RATE


@dataclass(frozen=True, eq=False)
class PosedCapture:
    """A capture without pictures.

    Attributes:
        theta: The truth about the object.
        X_WO: Its pose at rest, with which every push begins.
        pushes: The pushes.
        rollouts: What became of them, at the times of the pushers' logs; every `PER_FRAME`-th is a picture's.
    """

    theta: Theta
    X_WO: RigidTransform
    pushes: list[Push]
    rollouts: list[Rollout]


def pose_capture(spec: CaptureSpec, thing: Thing, theta: Theta | None = None, number: int = 4) -> PosedCapture:
    """Roll out the pushes of a capture.

    Args:
        spec: The capture.
        thing: Its object.
        theta: The truth about it; None for that of the specification.
        number: Number of pushes.
    """
    theta = theta or spec.theta(thing)
    roll_out, mesh = engine(spec.engine), thing.mesh()
    X_WO = settled(spec, thing, theta)
    mesh.apply_transform(X_WO.GetAsMatrix4())

    def amplification(push: Push) -> float:
        """Largest ratio of how far aside a push ends and how far aside it begins."""
        ends = [roll_out(thing, theta, X, push, np.array([0.0, push.motion.end_time + 0.3])).X_WO[-1] for X in starts]
        return max(_aside_by(ends[0], end) for end in ends[1:])

    starts = [X_WO, *(_aside(X_WO, sign) for sign in (1.0, -1.0))]
    pushes = draw_pushes(mesh, spec.shape, np.random.default_rng([spec.seed, 2]), number, amplification=amplification)
    rollouts = [roll_out(thing, theta, X_WO, push, log_times(push.frames, FRAME_RATE)) for push in pushes]
    return PosedCapture(theta, X_WO, pushes, rollouts)


def _aside(X_WO: RigidTransform, sign: float) -> RigidTransform:
    """Pose by `_ASIDE` along x and y and about z from another."""
    way, turn = sign * _ASIDE[0] / np.sqrt(2.0), sign * _ASIDE[1]
    return RigidTransform(
        RotationMatrix.MakeZRotation(turn) @ X_WO.rotation(), X_WO.translation() + np.array([way, way, 0.0])
    )


def _aside_by(X: RigidTransform, Y: RigidTransform) -> float:
    turned = abs((X.rotation() @ Y.rotation().inverse()).ToAngleAxis().angle())
    return max(float(np.linalg.norm(X.translation() - Y.translation())) / _ASIDE[0], turned / _ASIDE[1])


def settled(spec: CaptureSpec, thing: Thing, theta: Theta) -> RigidTransform:
    """Pose of an object that has come to rest near the origin, turned at random."""
    yaw, x, y = np.random.default_rng([spec.seed, 1]).uniform([-np.pi, -0.02, -0.02], [np.pi, 0.02, 0.02])
    R_WO = RotationMatrix.MakeZRotation(yaw)
    p_com = R_WO.matrix() @ theta.p_com
    points = thing.mesh().vertices if not len(theta.feet) else np.vstack([thing.mesh().vertices, theta.feet])
    X_WO = on_floor(points, R_WO, x - p_com[0], y - p_com[1], FLOOR_HEIGHT)
    return engine(spec.engine)(thing, theta, X_WO, None, np.array([0.0, _SETTLING_TIME])).X_WO[-1]


def write_poses(path: Path, spec: CaptureSpec, thing: Thing, posed: PosedCapture) -> None:
    """Write the poses of a capture into one file of arrays, which `read_poses` reads.

    Of episode k there are, with the prefix "ek_": t (n,) s, q (n, 4) wxyz and p (n, 3) m of the object at the times of
    the pictures; log_t (m,) s, log_p (m, 3) m and log_v (m, 3) m/s of the pusher; log_q, log_x: the object's pose at
    the times of the log; motion (10,): `StraightPush.to_vector`. Of the capture: X_WO_q, X_WO_p at the start, theta
    (mass, p_com, inertia, friction_floor, friction_pusher, feet), pusher_kind, pusher_radius, pusher_length, mesh_path,
    visual_path, engine, thing, split, episodes.
    """
    theta = posed.theta
    arrays: dict[str, Any] = {
        "name": spec.name,
        "thing": spec.thing,
        "engine": spec.engine,
        "split": spec.split,
        "seed": spec.seed,
        "mesh_path": str(thing.mesh_path),
        "visual_path": str(thing.visual_path),
        "mass": theta.mass,
        "p_com": theta.p_com,
        "inertia": theta.inertia,
        "friction_floor": theta.friction_floor,
        "friction_pusher": theta.friction_pusher,
        "feet": theta.feet,
        "pusher_kind": spec.pusher,
        "pusher_radius": spec.shape.radius,
        "pusher_length": spec.shape.length,
        "X_WO_q": posed.X_WO.rotation().ToQuaternion().wxyz(),
        "X_WO_p": posed.X_WO.translation(),
        "episodes": len(posed.pushes),
    }
    for k, (push, rollout) in enumerate(zip(posed.pushes, posed.rollouts, strict=True)):
        q, p = quaternions(rollout.X_WO), np.array([X.translation() for X in rollout.X_WO])
        v = np.array([push.motion.average_velocity(j, 1 / LOG_RATE) for j in range(len(rollout.t))])
        arrays |= {f"e{k}_t": rollout.t[::PER_FRAME], f"e{k}_q": q[::PER_FRAME], f"e{k}_p": p[::PER_FRAME]}
        arrays |= {f"e{k}_log_t": rollout.t, f"e{k}_log_p": rollout.p_WP, f"e{k}_log_v": v}
        arrays |= {f"e{k}_log_q": q, f"e{k}_log_x": p, f"e{k}_motion": push.motion.to_vector()}
    prepare_folder(path.parent)
    with replacing(path) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, **arrays)


def read_poses(path: Path) -> PosedCapture:
    """Poses of a capture from the file that `write_poses` has written."""
    with np.load(path, allow_pickle=False) as arrays:
        feet = arrays["feet"].reshape(-1, 3)
        mass, floor, pusher = (float(arrays[name]) for name in ("mass", "friction_floor", "friction_pusher"))
        theta = Theta(mass, floor, pusher, arrays["p_com"], arrays["inertia"], feet)
        radius, length = float(arrays["pusher_radius"]), float(arrays["pusher_length"])
        shape = PusherShape("sphere" if str(arrays["pusher_kind"]) == "sphere" else "capsule", radius, length)
        pushes, rollouts = [], []
        for k in range(int(arrays["episodes"])):
            motion = StraightPush.from_vector(arrays[f"e{k}_motion"])
            pushes.append(Push(shape, motion, len(arrays[f"e{k}_t"])))
            poses = [rigid(q, p) for q, p in zip(arrays[f"e{k}_log_q"], arrays[f"e{k}_log_x"], strict=True)]
            rollouts.append(Rollout(arrays[f"e{k}_log_t"], poses, arrays[f"e{k}_log_p"]))
        return PosedCapture(theta, rigid(arrays["X_WO_q"], arrays["X_WO_p"]), pushes, rollouts)
