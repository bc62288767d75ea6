"""Tables of an episode: times of its images, poses of the pusher and poses of the object."""

import os
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from pinwm_drake.capture.paths import require_file
from pinwm_drake.capture.refusals import Refuse, attempt, raise_it
from pinwm_drake.capture.scene import FARTHEST
from pinwm_drake.capture.tables import Table, read_table
from pinwm_drake.documents import LONGEST_TEXT

FRAMES_FILE, TRAJECTORY_FILE, POSES_FILE = "frames.csv", "trajectory.csv", "object_poses.csv"
FRAME_COLUMNS = ("frame", "file_path", "t")
POSITION, QUATERNION = ("px", "py", "pz"), ("qw", "qx", "qy", "qz")
VELOCITY, FORCE = ("vx", "vy", "vz"), ("fx", "fy", "fz")
# How far a frame may be outside the pusher's log [s]: times printed with six decimals.
_ROUNDING = 1.5e-6
_FASTEST, _STRONGEST = 1e3, 1e6  # m/s, N


@dataclass(frozen=True, eq=False)
class PusherTrajectory:
    """Poses of the pusher at m times; in between it moves on straight lines.

    Attributes:
        t: (m,) [s], increasing.
        p_WP: (m, 3) [m].
        q_WP: (m, 4), wxyz, unit norm.
        v_WP: (m, 3) [m/s], the commanded velocity from each time to the next.
        force_W: (m, 3) [N], that the object exerts on the pusher, as a sensor in the pusher's stem reads it without the
            pusher's own weight; axes of the world. None where it was not measured.
    """

    t: np.ndarray
    p_WP: np.ndarray
    q_WP: np.ndarray
    v_WP: np.ndarray
    force_W: np.ndarray | None


@dataclass(frozen=True, eq=False)
class ObjectPoses:
    """Poses of the object at n times.

    Attributes:
        t: (n,) [s], increasing.
        p_WO: (n, 3) [m].
        q_WO: (n, 4), wxyz, unit norm.
    """

    t: np.ndarray
    p_WO: np.ndarray
    q_WO: np.ndarray


def read_trajectory(folder: Path, refuse: Refuse = raise_it) -> PusherTrajectory:
    """The pusher's log from `trajectory.csv`.

    Args:
        folder: Folder of the episode.
        refuse: Receives the problems of rows and cells; where it does not raise, NaN takes their place.

    Raises:
        InputError: The table cannot be used; see `episodes.read_episode`.
    """
    columns = ("t", *POSITION, *QUATERNION, *VELOCITY)
    table = read_table(folder / TRAJECTORY_FILE, columns, FORCE, refuse)
    return PusherTrajectory(
        t=table.times(),
        p_WP=table.numbers(POSITION, FARTHEST),
        q_WP=table.quaternions(QUATERNION),
        v_WP=table.numbers(VELOCITY, _FASTEST),
        force_W=table.numbers(FORCE, _STRONGEST) if FORCE[0] in table.cells else None,
    )


def read_object_poses(folder: Path, refuse: Refuse = raise_it) -> ObjectPoses | None:
    """The object's poses from `object_poses.csv`, as `read_pose_table`; None where there is no such file."""
    path = folder / POSES_FILE
    return read_pose_table(path, refuse) if os.path.lexists(path) else None


def read_pose_table(path: Path, refuse: Refuse = raise_it) -> ObjectPoses:
    """Poses of an object from a table with the columns of `object_poses.csv`.

    Args:
        path: The file.
        refuse: Receives problems, as for `read_trajectory`.

    Raises:
        InputError: The table cannot be used; see `episodes.read_episode`.
    """
    table = read_table(path, ("t", *POSITION, *QUATERNION), refuse=refuse)
    return ObjectPoses(table.times(), table.numbers(POSITION, FARTHEST), table.quaternions(QUATERNION))


def read_frame_table(
    folder: Path, trajectory_t: np.ndarray | None, refuse: Refuse = raise_it
) -> tuple[list[str], np.ndarray]:
    """The images of an episode from `frames.csv`: their names as written, and their times (n,) [s].

    Args:
        folder: Folder of the episode.
        trajectory_t: (m,) [s], the times of the pusher's log; None leaves the comparison out.
        refuse: Receives problems, as for `read_trajectory`.

    Raises:
        InputError: The table cannot be used, or an image is missing; see `episodes.read_episode`.
    """
    table = read_table(folder / FRAMES_FILE, FRAME_COLUMNS, refuse=refuse)
    t = table.times()
    _require_numbers(table)
    names = [text.strip() for text in table.cells["file_path"]]
    seen: dict[str, int] = {}
    for row, name in enumerate(names):
        first = seen.setdefault(name, table.lines[row])
        if first != table.lines[row]:
            refuse(table.refusal(row, "file_path", f"each image once (it is in row {first} too)"))
        if not name or not name.isprintable() or len(name) > LONGEST_TEXT:
            refuse(table.refusal(row, "file_path", "the name of an image file"))
        else:
            wanted = f"the image file of {table.path}, row {table.lines[row]}"
            attempt(partial(require_file, folder / name, wanted), refuse)
    if trajectory_t is not None:
        start, end = float(np.min(trajectory_t)), float(np.max(trajectory_t))
        for row in np.nonzero((t < start - _ROUNDING) | (t > end + _ROUNDING))[0].tolist():
            refuse(table.refusal(row, "t", f"a time within {TRAJECTORY_FILE}: {start:.9g} s to {end:.9g} s"))
    return names, t


def _require_numbers(table: Table) -> None:
    """Requires column `frame` of `frames.csv` to be whole and increasing."""
    values = table.numbers(("frame",), 1e9)[:, 0]
    for row, value in enumerate(values.tolist()):
        before = values[row - 1] if row else -1.0
        if np.isnan(value):
            continue  # refused as no number
        if value != np.floor(value) or value <= before:
            allowed = "a whole number, larger than the one in the row before" if row else "a whole number from 0"
            table.refuse(table.refusal(row, "frame", allowed))
