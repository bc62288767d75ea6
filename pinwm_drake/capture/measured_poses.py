# SPDX-License-Identifier: MIT
"""Measured poses of an object, as motion capture and pose estimators write them: a table of one push."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from pinwm_drake.capture.episode_tables import (
    POSITION,
    QUATERNION,
    ObjectPoses,
    PusherTrajectory,
    read_table,
)
from pinwm_drake.capture.episodes import Episode
from pinwm_drake.capture.scene import FARTHEST
from pinwm_drake.errors import InputError
from pinwm_drake.spatial.poses import Pose

_XYZ, _PLANAR = ("x", "y", "z"), ("x", "y", "yaw")
_MOST_TURNS = 1e4  # rad
_FEWEST = 2


@dataclass(frozen=True, eq=False)
class MeasuredPoses:
    """Poses of an object that were measured.

    Attributes:
        path: File of the table.
        poses: The poses, as `ObjectPoses`.
        planar: Flag: x, y and yaw were measured only; the rest is that of the object at rest.
        lines: Lines of the rows in the file.
        left_out: Number of rows before or after the pusher's log.
    """

    path: Path
    poses: ObjectPoses
    planar: bool
    lines: list[int]
    left_out: int = 0


def poses_files(poses: Path, episodes: Sequence[Episode]) -> list[Path]:
    """Return the table of each episode: the file of that name in its folder, where one of them has it, else the file.

    Raises:
        InputError: No folder has it, and there are several episodes.
    """
    own = [episode.folder / poses for episode in episodes]
    if not poses.is_absolute() and any(path.is_file() for path in own):
        return own
    if len(episodes) > 1:
        raise InputError(
            poses, value=f"one file for {len(episodes)} pushes", allowed="the name of a file in each folder"
        )
    return [poses]


def read_measured_poses(path: Path, X_WO: Pose) -> MeasuredPoses:
    """Read a table with columns t, px..pz (or x, y, z), qw..qz, or t, x, y, yaw; s, m, rad.

    Args:
        path: The file.
        X_WO: Pose of the object at rest, q (4,), p (3,) [m], for what a planar table leaves out: yaw turns the object
            about z from where its heading, that of its x axis in the plane, is 0.

    Raises:
        InputError: The table cannot be used; the message names row, column, value, and what is allowed.
    """
    table = read_table(path, ("t", *POSITION, *QUATERNION), forms=(("t", *_XYZ, *QUATERNION), ("t", *_PLANAR)))
    planar = "yaw" in table.cells
    position = _PLANAR[:2] if planar else _XYZ if "x" in table.cells else POSITION
    t, p = table.times(), table.numbers(position, FARTHEST)
    if len(t) < _FEWEST:
        raise InputError(path, value=f"{len(t)} row", allowed=f"{_FEWEST} or more")
    if not planar:
        return MeasuredPoses(path, ObjectPoses(t, p, table.quaternions()), False, table.lines)
    rest = Rotation.from_quat(X_WO.q.numpy(), scalar_first=True)
    ahead = rest.apply([1.0, 0.0, 0.0])
    level = Rotation.from_rotvec([0.0, 0.0, -np.arctan2(ahead[1], ahead[0])]) * rest
    turns = np.pad(table.numbers(("yaw",), _MOST_TURNS), ((0, 0), (2, 0)))
    q = (Rotation.from_rotvec(turns) * level).as_quat(scalar_first=True)
    p = np.concatenate([p, np.full((len(t), 1), float(X_WO.p[2]))], -1)
    return MeasuredPoses(path, ObjectPoses(t, p, q), True, table.lines)


def within_log(measured: MeasuredPoses, log: PusherTrajectory) -> MeasuredPoses:
    """Return the rows during which the pusher was logged.

    Raises:
        InputError: They are fewer than two, as of another clock.
    """
    poses = measured.poses
    inside = (poses.t >= log.t[0] - 1e-6) & (poses.t <= log.t[-1] + 1e-6)
    if int(inside.sum()) < _FEWEST:
        found = f"t = {poses.t[0]:.9g} s to {poses.t[-1]:.9g} s"
        allowed = f"times within the pusher's log, {log.t[0]:.9g} s to {log.t[-1]:.9g} s: is it another clock?"
        raise InputError(measured.path, value=found, allowed=allowed)
    kept = ObjectPoses(poses.t[inside], poses.p_WO[inside], poses.q_WO[inside])
    lines = [line for line, one in zip(measured.lines, inside, strict=True) if one]
    return replace(measured, poses=kept, lines=lines, left_out=int((~inside).sum()))
