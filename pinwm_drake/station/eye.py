# SPDX-License-Identifier: MIT
"""Eye of an episode: the pinhole that its images are written for, and what turns film and log of a lab into its own."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
import torch

from pinwm_drake.capture.episode_tables import PusherTrajectory
from pinwm_drake.capture.episodes import CAMERA_FILE, read_fixed_camera
from pinwm_drake.capture.images import size_of
from pinwm_drake.capture.importers.film import Film
from pinwm_drake.capture.lens import Lens
from pinwm_drake.capture.paths import is_file, is_folder
from pinwm_drake.capture.remap import Remap
from pinwm_drake.capture.scene import CAPTURE_FILE, EPISODES, Capture
from pinwm_drake.capture.transforms import read_camera, read_pose, require_known
from pinwm_drake.documents import read_json
from pinwm_drake.errors import InputError
from pinwm_drake.rendering.camera import Camera
from pinwm_drake.spatial.poses import Pose
from pinwm_drake.spatial.rigid import apply, from_pose, inverse, to_pose
from pinwm_drake.spatial.rotations import quaternion_multiply
from pinwm_drake.station.document import Station, load_station
from pinwm_drake.station.named import STATION_FILE, require_station

_LONGEST = 1600  # px of a side of the images of a pinhole


@dataclass(frozen=True, eq=False)
class Eye:
    """Camera of an episode.

    Attributes:
        camera: The pinhole, with intrinsics (4,).
        X_WC: Its pose, OpenCV axes: q (4,), p (3,) [m].
        lens: Lens of the film; None where the film is that of the pinhole.
        X_WB: (4, 4), frame of the log in W; None where the log is in W.
    """

    camera: Camera
    X_WC: Pose
    lens: Lens | None = None
    X_WB: np.ndarray | None = None

    @cached_property
    def _remap(self) -> Remap | None:
        return None if self.lens is None else Remap(self.lens, self.camera)

    def seen(self, image: np.ndarray, outside: int = 255) -> np.ndarray:
        """Image (height, width, channels) uint8 of the film as the pinhole sees it, `outside` where it does not."""
        return image if self._remap is None else self._remap(np.ascontiguousarray(image), outside)

    def require_size(self, path: Path, image: np.ndarray, why: str) -> None:
        """Require an image (H, W, 3) of the film to have the size of its lens; raise InputError that says why."""
        film = self.camera if self.lens is None else self.lens
        width, height = film.width, film.height
        if image.shape[:2] != (height, width):
            raise InputError(path, value=f"a film of {size_of(image)}", allowed=f"{width} x {height} px, {why}")

    def film(self, film: Film) -> Film:
        """Film as the pinhole sees it."""
        frames = film.frames

        def seen(numbers: Sequence[int]) -> Iterator[np.ndarray]:
            return (self.seen(frame) for frame in frames(numbers))

        return replace(film, frames=seen)

    def log(self, log: PusherTrajectory) -> PusherTrajectory:
        """Log in W."""
        if self.X_WB is None:
            return log
        R_WB, q_WB = self.X_WB[:3, :3], to_pose(self.X_WB).q
        force = None if log.force_W is None else log.force_W @ R_WB.T
        q_WP = quaternion_multiply(q_WB.expand(len(log.t), 4), torch.from_numpy(log.q_WP)).numpy()
        return PusherTrajectory(log.t, apply(self.X_WB, log.p_WP), q_WP, log.v_WP @ R_WB.T, force)


def pinhole_of(lens: Lens) -> Camera:
    """Pinhole in place of a lens, of the same size, or a whole number of times as small where that is large."""
    times = -(-max(lens.width, lens.height) // _LONGEST)
    intrinsics = torch.from_numpy(np.array(lens.intrinsics, float) / times)
    return Camera(lens.width // times, lens.height // times, intrinsics)


def eye_of(station: Station) -> Eye:
    """Eye of a station with a fixed camera: films are freed of distortion, logs are in the robot's base.

    Raises:
        InputError: The camera is in the hand.
    """
    camera, X_BW = pinhole_of(station.lens), from_pose(station.document.world.X_BW.pose())
    return Eye(camera, station.X_WC, station.lens, inverse(X_BW))


def read_eye(capture: Capture, file: Path | None, first: np.ndarray) -> Eye:
    """Eye of an episode that is to be made.

    Args:
        capture: The capture.
        file: A `station.yaml`, a file with the keys of `camera.json`, or the folder with one of them; None for the
            camera of the last episode.
        first: (height, width, channels), the film's first image.

    Raises:
        InputError: There is no such file, it is refused, or its camera has images of another size.
    """
    if file is None:
        if not capture.episode_names:
            allowed = "--camera FILE: a station.yaml, or intrinsics and pose of the camera as episodes/NAME/camera.json"
            raise InputError(capture.folder, value="no episode whose camera could be taken", allowed=allowed)
        file = capture.folder / EPISODES / capture.episode_names[-1] / CAMERA_FILE
    if file.suffix in (".yaml", ".yml") or is_file(file / STATION_FILE):
        station = load_station(file)
        require_station(capture.folder / CAPTURE_FILE, capture.station, station.sha256, station.path)
        eye = eye_of(station)
    elif is_folder(file) or file.name == CAMERA_FILE:
        eye = Eye(*read_fixed_camera(file if is_folder(file) else file.parent))
    else:
        document = read_json(file)
        require_known(document)
        eye = Eye(read_camera(document, document), read_pose(document["transform_matrix"]))
    eye.require_size(file, first, f"as {file} says")
    return eye
