# SPDX-License-Identifier: MIT
"""Captures of real measurements: poses and the pusher's log, without images."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
import trimesh
import yaml
from scipy.spatial.transform import Rotation

from pinwm_drake.capture.episode_tables import POSES_FILE, TRAJECTORY_FILE, ObjectPoses, PusherTrajectory
from pinwm_drake.capture.episodes import START_FILE
from pinwm_drake.capture.scene import PusherShape
from pinwm_drake.capture.write import write_capture_yaml, write_pose_table, write_trajectory
from pinwm_drake.spatial.poses import Pose

_LEVEL = np.array([1.0, 0.0, 0.0, 0.0])
_SIDES = 128  # of a circle
_TIP_LENGTH, _TIP_GAP = 0.1, 0.002  # m; the gap is that between tip and floor
_MIT_HEIGHT, _MIT_TIP, _MIT_SPEED = 0.013, 0.00475, 0.01  # m, m, m/s
_CMU_LEG, _CMU_HEIGHT, _CMU_TIP, _CMU_MASS = 0.15, 0.013, 0.001, 1.518  # m, m, m, kg
_HALF_CUBE, _CUBE_MASS, _TOSS_RATE = 0.0524, 0.37, 148.0  # m, kg, Hz
_AWAY = np.array([5.0, 5.0, 5.0])  # m
_AFTER = 0.1  # s, of a log after the pusher stops

_TRI1 = ((0.045, 0.045), (-0.0809, 0.045), (0.045, -0.08087))
_TRI2 = ((0.045, 0.045), (-0.106, 0.045), (0.045, -0.08087))


def _ellipse(a: float, b: float) -> np.ndarray:
    angle = 2.0 * np.pi * np.arange(_SIDES) / _SIDES
    return np.stack([a * np.cos(angle), b * np.sin(angle)], -1)


def _rectangle(a: float, b: float) -> np.ndarray:
    return 0.5 * np.array([(a, b), (-a, b), (-a, -b), (a, -b)])


_HEX = 0.0605 * np.stack([np.cos(np.pi / 3 * np.arange(6)), np.sin(np.pi / 3 * np.arange(6))], -1)
# Outlines of MIT's objects in their own frame, m.
OUTLINES = {
    "rect1": _rectangle(0.09, 0.09),
    "rect2": _rectangle(0.08991, 0.11258),
    "tri1": np.array(_TRI1),
    "tri2": np.array(_TRI2),
    "ellip1": _ellipse(0.0525, 0.0525),
    "ellip2": _ellipse(0.0525, 0.065445),
    "hex": _HEX,
}
# CMU's triangle: its frame is in its middle, its right angle at the lower left.
TRIANGLE = np.array([(-1.0, -1.0), (2.0, -1.0), (-1.0, 2.0)]) * _CMU_LEG / 3.0


@dataclass(frozen=True, eq=False)
class RealPush:
    """One push: planar poses (n, 3) of the object, x, y [m] and yaw [rad], at times (n,) [s], and the tip's path."""

    t: np.ndarray
    poses: np.ndarray
    tip_t: np.ndarray  # (m,) [s]
    tip: np.ndarray  # (m, 2) [m]


def mit_push(row: np.ndarray) -> RealPush:
    """Push of a row (10,): pose before, pose after, tip from and to."""
    seconds = float(np.hypot(*(row[8:10] - row[6:8]))) / _MIT_SPEED
    t = np.array([0.0, seconds])
    return RealPush(np.array([0.0, seconds + _AFTER]), row[:6].reshape(2, 3), t, row[6:].reshape(2, 2))


def triangle_pushes(data: dict[str, np.ndarray]) -> list[RealPush]:
    """Pushes of a set of CMU's triangle."""
    found = []
    for number, (pre, post) in enumerate(zip(data["pre"], data["post"], strict=True)):
        rows = data["finger"][data["finger"][:, 0] == number]
        t, first = np.unique(rows[:, 1], return_index=True)
        found.append(RealPush(np.array([t[0], t[-1] + _AFTER]), np.stack([pre, post]), t, rows[first, 2:4]))
    return found


def write_mit(folder: Path, name: str, pushes: list[RealPush]) -> Path:
    """Write the pushes of one of MIT's pairs, SURFACE_SHAPE, as a capture."""
    outline = OUTLINES[name.rpartition("_")[2]]
    return _write_planar(folder, name, outline, _MIT_HEIGHT, None, _MIT_TIP, pushes)


def write_triangle(folder: Path, name: str, pushes: list[RealPush]) -> Path:
    """Write the pushes of one of CMU's sets as a capture."""
    return _write_planar(folder, name, TRIANGLE, _CMU_HEIGHT, _CMU_MASS, _CMU_TIP, pushes)


@dataclass(frozen=True, eq=False)
class Toss:
    """Poses of a thrown object at times (n,) [s]: q (n, 4), p (n, 3) [m], and its velocity (6,) at first."""

    t: np.ndarray
    q: np.ndarray
    p: np.ndarray
    V: np.ndarray


def read_tosses(path: Path) -> list[Toss]:
    """Tosses of ContactNets' cube; z counts from the floor."""
    arrays = np.load(path)
    ends = np.cumsum(arrays["length"])
    found = []
    for first, end in zip(ends - arrays["length"], ends, strict=True):
        rows = arrays["rows"][first:end]
        q = rows[:, 3:7] / np.linalg.norm(rows[:, 3:7], axis=1, keepdims=True)
        p, v, omega_O = rows[:, :3] * _HALF_CUBE, rows[0, 7:10] * _HALF_CUBE, rows[0, 10:13]
        omega = Rotation.from_quat(q[0], scalar_first=True).apply(omega_O)
        found.append(Toss(np.arange(len(rows)) / _TOSS_RATE, q, p, np.concatenate([omega, v])))
    return found


def write_tosses(folder: Path, tosses: list[Toss]) -> Path:
    """Write tosses as a capture whose pusher stands far away."""
    (folder / "meshes").mkdir(parents=True, exist_ok=True)
    trimesh.creation.box(extents=(2.0 * _HALF_CUBE,) * 3).export(folder / "meshes/object.obj")
    level = Pose(torch.from_numpy(_LEVEL), torch.tensor([0.0, 0.0, _HALF_CUBE], dtype=torch.float64))
    _write_scene(folder, "contactnets_cube", _CUBE_MASS, level, PusherShape("sphere", 0.01))
    for number, toss in enumerate(tosses):
        episode = folder / "episodes" / f"{number:04}"
        episode.mkdir(parents=True, exist_ok=True)
        start = {"p": toss.p[0].tolist(), "q": toss.q[0].tolist()}
        text = yaml.safe_dump({"X_WO": start, "V_WO": toss.V.tolist()}, default_flow_style=None)
        (episode / START_FILE).write_text(text)
        t = toss.t[[0, -1]]
        still = PusherTrajectory(t, np.tile(_AWAY, (2, 1)), np.tile(_LEVEL, (2, 1)), np.zeros((2, 3)), None)
        write_trajectory(episode / TRAJECTORY_FILE, still)
        write_pose_table(episode / POSES_FILE, ObjectPoses(toss.t, toss.p, toss.q))
    return folder


def _write_planar(
    folder: Path,
    name: str,
    outline: np.ndarray,
    height: float,
    mass: float | None,
    tip_radius: float,
    pushes: list[RealPush],
) -> Path:
    """Write a capture of an object that is a prism over an outline (k, 2) [m], with an episode for each push."""
    (folder / "meshes").mkdir(parents=True, exist_ok=True)
    hull = trimesh.convex.convex_hull(
        np.concatenate([np.pad(outline, ((0, 0), (0, 1)), constant_values=z) for z in (-0.5 * height, 0.5 * height)])
    )
    hull.export(folder / "meshes/object.obj")
    middle = np.mean([push.poses[0, :2] for push in pushes], axis=0)
    shape = PusherShape("cylinder", tip_radius, _TIP_LENGTH)
    _write_scene(folder, name, mass, _planar(np.array([*middle, 0.0]), height), shape)
    for number, push in enumerate(pushes):
        _write_push(folder / "episodes" / f"{number:04}", push, height)
    return folder


def _write_scene(folder: Path, name: str, mass: float | None, X_WO: Pose, shape: PusherShape) -> None:
    write_capture_yaml(
        folder,
        name=name,
        mesh="meshes/object.obj",
        mass=mass,
        X_WO=X_WO,
        pusher_mesh=None,
        pusher_shape=shape,
        floor_height=0.0,
        gravity=9.81,
    )


def _write_push(folder: Path, push: RealPush, height: float) -> None:
    """Write an episode: start, log of the tip and poses."""
    folder.mkdir(parents=True, exist_ok=True)
    start = _planar(push.poses[0], height)
    text = yaml.safe_dump({"X_WO": {"p": start.p.tolist(), "q": start.q.tolist()}}, default_flow_style=None)
    (folder / START_FILE).write_text(text)
    t = np.append(push.tip_t, push.t[-1]) if push.t[-1] > push.tip_t[-1] else push.tip_t
    p = np.pad(push.tip, ((0, len(t) - len(push.tip)), (0, 0)), mode="edge")
    p = np.pad(p, ((0, 0), (0, 1)), constant_values=0.5 * _TIP_LENGTH + _TIP_GAP)
    v = np.pad(np.diff(p, axis=0) / np.diff(t)[:, None], ((0, 1), (0, 0)))
    q = np.tile(_LEVEL, (len(t), 1))
    write_trajectory(folder / TRAJECTORY_FILE, PusherTrajectory(t, p, q, v, None))
    X_WO = [_planar(pose, height) for pose in push.poses]
    poses = ObjectPoses(push.t, np.stack([X.p.numpy() for X in X_WO]), np.stack([X.q.numpy() for X in X_WO]))
    write_pose_table(folder / POSES_FILE, poses)


def _planar(pose: np.ndarray, height: float) -> Pose:
    """Pose q (4,), p (3,) [m] of a prism on the floor at x, y [m] and yaw [rad]."""
    half = 0.5 * float(pose[2])
    return Pose(
        torch.tensor([np.cos(half), 0.0, 0.0, np.sin(half)], dtype=torch.float64),
        torch.tensor([pose[0], pose[1], 0.5 * height], dtype=torch.float64),
    )
