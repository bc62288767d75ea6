# SPDX-License-Identifier: MIT
"""The folder of a simulated episode, as captures have it."""

from pathlib import Path

import numpy as np
import torch
from PIL import Image
from pydrake.common.eigen_geometry import Quaternion
from pydrake.math import RigidTransform, RotationMatrix

from pinwm_drake.capture.episode_tables import read_object_poses
from pinwm_drake.capture.scene import CAPTURE_FILE, EPISODES, load_capture
from pinwm_drake.capture.write import write_episode_tables
from pinwm_drake.geometry.meshes import load_mesh
from pinwm_drake.spatial.poses import Pose
from pinwm_drake.systems.runs.episode import Record
from pinwm_drake.systems.scenario.setup import Setup
from pinwm_drake.systems.scenario.start import on_floor

_IMAGES = "rgb"


class EpisodeFolder:
    """Take images as they come, and tables at the end: camera.json, frames.csv, trajectory.csv, object_poses.csv."""

    def __init__(self, folder: Path, setup: Setup) -> None:
        self._folder, self._setup = folder, setup
        self._names: list[str] = []
        self._times: list[float] = []
        (folder / _IMAGES).mkdir()

    def add(self, t: float, rgb: np.ndarray) -> None:
        """Write an image (height, width, 4) uint8, taken at t [s]."""
        self._names.append(f"{_IMAGES}/{len(self._names):05d}.png")
        self._times.append(t)
        Image.fromarray(rgb).save(self._folder / self._names[-1])

    def finish(self, record: Record) -> None:
        """Write the tables; the poses are those of every period, and so more than there are images.

        Raises:
            InputError: A file cannot be written.
        """
        X_WC = self._setup.X_WC
        pose = Pose(torch.tensor(X_WC.rotation().ToQuaternion().wxyz()), torch.tensor(X_WC.translation()))
        t, trajectory, poses = np.array(self._times), record.trajectory(), record.object_poses()
        write_episode_tables(self._folder, self._setup.camera, pose, self._names, t, trajectory, poses)


def start_of_log(folder: Path, setup: Setup) -> RigidTransform | None:
    """Return the pose of the object with which an episode starts, on the floor of the setup.

    Args:
        folder: That of the log: an episode of a capture, or one that `pinwm simulate` wrote.
        setup: Its object may be another one.

    Returns:
        X_WO as the capture says it, or else as the table of poses beside the log does; None where there is neither.

    Raises:
        InputError: The capture or the table cannot be used.
    """
    whole = folder.absolute()
    if whole.parent.name == EPISODES and (whole.parent.parent / CAPTURE_FILE).is_file():
        start = load_capture(whole.parent.parent).object.X_WO
        q_WO, p_WO = start.q.numpy(), start.p.numpy()
    else:
        poses = read_object_poses(folder)
        if poses is None:
            return None
        q_WO, p_WO = poses.q_WO[0], poses.p_WO[0]
    R_WO = RotationMatrix(Quaternion(wxyz=q_WO / np.linalg.norm(q_WO)))
    return on_floor(load_mesh(setup.twin.mesh_path).vertices, R_WO, p_WO[0], p_WO[1], setup.twin.floor_height)
