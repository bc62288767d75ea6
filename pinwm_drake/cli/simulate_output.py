"""The folder of a simulated episode, as captures have it."""

from pathlib import Path

import numpy as np
import torch
from PIL import Image

from pinwm_drake.capture.write import write_episode_tables
from pinwm_drake.spatial.poses import Pose
from pinwm_drake.systems.episode import Record
from pinwm_drake.systems.setup import Setup

_IMAGES = "rgb"


class EpisodeFolder:
    """Takes images as they come, and tables in the end: camera.json, frames.csv, trajectory.csv, object_poses.csv."""

    def __init__(self, folder: Path, setup: Setup) -> None:
        """Takes an existing folder, and the setup whose camera takes the images."""
        self._folder, self._setup = folder, setup
        self._names: list[str] = []
        self._times: list[float] = []
        (folder / _IMAGES).mkdir()

    def add(self, t: float, rgb: np.ndarray) -> None:
        """Writes an image (height, width, 4) uint8, taken at t [s]."""
        self._names.append(f"{_IMAGES}/{len(self._names):05d}.png")
        self._times.append(t)
        Image.fromarray(rgb).save(self._folder / self._names[-1])

    def finish(self, record: Record) -> None:
        """Writes the tables; the poses are those of every period, and so more than there are images.

        Raises:
            InputError: A file cannot be written.
        """
        X_WC = self._setup.X_WC
        pose = Pose(torch.tensor(X_WC.rotation().ToQuaternion().wxyz()), torch.tensor(X_WC.translation()))
        t, trajectory, poses = np.array(self._times), record.trajectory(), record.object_poses()
        write_episode_tables(self._folder, self._setup.camera, pose, self._names, t, trajectory, poses)
