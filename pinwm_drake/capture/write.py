# SPDX-License-Identifier: MIT
"""Writing of a capture's files, each of which appears whole or not at all."""

import csv
import io
import json
from pathlib import Path
from typing import Any

import numpy as np

from pinwm_drake.capture.episode_tables import (
    FORCE,
    FRAME_COLUMNS,
    FRAMES_FILE,
    POSES_FILE,
    POSITION,
    QUATERNION,
    TRAJECTORY_FILE,
    VELOCITY,
    ObjectPoses,
    PusherTrajectory,
)
from pinwm_drake.capture.episodes import CAMERA_FILE
from pinwm_drake.capture.scene import CAPTURE_FILE, SCHEMA_VERSION, UNITS, PusherShape
from pinwm_drake.documents import yaml_text
from pinwm_drake.files import prepare_folder, replacing
from pinwm_drake.rendering.camera import Camera
from pinwm_drake.spatial.poses import Pose, pose_to_matrix


def write_capture_yaml(
    folder: Path,
    *,
    name: str,
    mesh: str,
    mass: float | None,
    X_WO: Pose,
    pusher_mesh: str | None,
    pusher_shape: PusherShape | None,
    floor_height: float,
    gravity: float,
) -> None:
    """Write the scene of a capture to its `capture.yaml`.

    Args:
        folder: The capture; made if need be.
        name, mass: Name of the object, and its mass, kg; None where it was not measured.
        mesh, pusher_mesh: Paths of the meshes from `folder`.
        X_WO: Pose of the object in the static views and at the start of an episode; q (4,), p (3,) [m].
        pusher_shape: The pusher's shape; or None.
        floor_height: Height of the floor, m.
        gravity: m/s^2, downwards.

    Raises:
        InputError: The file cannot be written.
    """
    shape = None
    if pusher_shape is not None:
        shape = {"kind": pusher_shape.kind, "radius": float(pusher_shape.radius), "length": float(pusher_shape.length)}
    document = {
        "schema_version": SCHEMA_VERSION,
        "units": dict(UNITS),
        "gravity": float(gravity),
        "object": {
            "name": name,
            "mesh": mesh,
            "mass": None if mass is None else float(mass),
            "X_WO": {"p": X_WO.p.tolist(), "q": X_WO.q.tolist()},
        },
        "pusher": {"mesh": pusher_mesh, "shape": shape},
        "floor": {"height": float(floor_height)},
    }
    _write_text(prepare_folder(folder) / CAPTURE_FILE, yaml_text(document))


def write_posed_images(path: Path, frames: list[tuple[str, Camera, Pose]]) -> None:
    """Write a `transforms.json` of nerfstudio, with poses in OpenGL's axes.

    Args:
        path: The file; its folder is made if need be.
        frames: Path of each image from the folder of the file, its camera with intrinsics (4,), and its pose X_WC
            (OpenCV axes), q (4,), p (3,) [m].

    Raises:
        InputError: The file cannot be written.
    """
    common = _intrinsics(frames[0][1]) if frames else {}
    entries = []
    for name, camera, X_WC in frames:
        own = {key: value for key, value in _intrinsics(camera).items() if value != common[key]}
        entries.append({"file_path": name, **own, "transform_matrix": _opengl(X_WC)})
    prepare_folder(path.parent)
    _write_text(path, json.dumps({**common, "frames": entries}, indent=1) + "\n")


def write_episode_tables(
    folder: Path,
    camera: Camera,
    X_WC: Pose,
    file_names: list[str],
    t: np.ndarray,
    trajectory: PusherTrajectory,
    object_poses: ObjectPoses | None,
) -> None:
    """Write `camera.json`, `frames.csv`, `trajectory.csv` and, where they are known, `object_poses.csv`.

    Args:
        folder: Folder of the episode; made if need be.
        camera: Size and intrinsics (4,).
        X_WC: Pose of the camera (OpenCV axes), q (4,), p (3,) [m].
        file_names: The images, n paths from `folder`.
        t: (n,) [s], when they were taken.
        trajectory: Poses of the pusher.
        object_poses: Poses of the object; None leaves the file out, and removes an earlier one.

    Raises:
        InputError: A file cannot be written.
    """
    posed = {**_intrinsics(camera), "transform_matrix": _opengl(X_WC)}
    _write_text(prepare_folder(folder) / CAMERA_FILE, json.dumps(posed, indent=1) + "\n")
    rows = [[k, name, float(time)] for k, (name, time) in enumerate(zip(file_names, t, strict=True))]
    _write_table(folder / FRAMES_FILE, FRAME_COLUMNS, rows)
    write_trajectory(folder / TRAJECTORY_FILE, trajectory)
    if object_poses is None:
        (folder / POSES_FILE).unlink(missing_ok=True)
    else:
        write_pose_table(folder / POSES_FILE, object_poses)


def write_trajectory(path: Path, trajectory: PusherTrajectory) -> None:
    """Write a motion of the pusher with the columns of `trajectory.csv`.

    Raises:
        InputError: The file cannot be written.
    """
    force = trajectory.force_W
    columns = ("t", *POSITION, *QUATERNION, *VELOCITY, *(FORCE if force is not None else ()))
    parts = [trajectory.t[:, None], trajectory.p_WP, trajectory.q_WP, trajectory.v_WP]
    _write_table(path, columns, np.hstack(parts if force is None else [*parts, force]).tolist())


def write_pose_table(path: Path, poses: ObjectPoses) -> None:
    """Write poses of an object with the columns of `object_poses.csv`.

    Raises:
        InputError: The file cannot be written.
    """
    values = np.hstack([poses.t[:, None], poses.p_WO, poses.q_WO])
    _write_table(path, ("t", *POSITION, *QUATERNION), values.tolist())


def _intrinsics(camera: Camera) -> dict[str, Any]:
    numbers = zip(("fl_x", "fl_y", "cx", "cy"), camera.intrinsics.tolist(), strict=True)
    return {"camera_model": "PINHOLE", "w": camera.width, "h": camera.height, **dict(numbers)}


def _opengl(X_WC: Pose) -> list[list[float]]:
    """Return the matrix of a pose, from OpenCV's axes (x right, y down, z forward) to OpenGL's."""
    return (pose_to_matrix(X_WC).numpy() @ np.diag([1.0, -1.0, -1.0, 1.0]) + 0.0).tolist()


def _write_table(path: Path, columns: tuple[str, ...], rows: list[list[Any]]) -> None:
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(rows)
    _write_text(path, text.getvalue())


def _write_text(path: Path, text: str) -> None:
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8", newline="")
