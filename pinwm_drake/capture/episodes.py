# SPDX-License-Identifier: MIT
"""Episode of one push: camera, images, the pusher's log and, where they are known, the object's poses."""

import os
import warnings
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated

import numpy as np
import torch

from pinwm_drake.capture.clock import EpisodeClock, read_clock
from pinwm_drake.capture.episode_tables import FRAMES_FILE, read_frame_table, read_object_poses, read_trajectory
from pinwm_drake.capture.episode_tables import ObjectPoses as ObjectPoses
from pinwm_drake.capture.episode_tables import PusherTrajectory as PusherTrajectory
from pinwm_drake.capture.images import read_image, require_size
from pinwm_drake.capture.scene import EPISODES, Capture, PoseDocument, UnfinishedCapture, load_capture
from pinwm_drake.capture.static_views import find_mask
from pinwm_drake.capture.transforms import read_camera, read_pose, require_known
from pinwm_drake.capture.units import require_computable
from pinwm_drake.documents import Document, FromList, finite, read_json, read_yaml
from pinwm_drake.errors import InputError
from pinwm_drake.rendering.camera import Camera
from pinwm_drake.spatial.poses import Pose

CAMERA_FILE, CAMERAS, START_FILE = "camera.json", "cameras", "start.yaml"
# Camera of an episode without a film.
_NO_CAMERA = Camera(1, 1, torch.tensor([1.0, 1.0, 0.5, 0.5], dtype=torch.float64))
_FASTEST = 1e3  # m/s, rad/s
_NOWHERE = Pose(torch.tensor([1.0, 0.0, 0.0, 0.0], dtype=torch.float64), torch.zeros(3, dtype=torch.float64))


@dataclass(frozen=True, eq=False)
class View:
    """Pictures of a push by one camera, which stands still.

    Attributes:
        name: Name of the camera's folder; "" for the camera of the episode's folder itself.
        folder: Folder of its files.
        camera: Size and intrinsics (4,).
        X_WC: Pose of the camera in the world, OpenCV axes; q (4,), p (3,) [m].
        file_names: The n images, as written in `frames.csv`: paths that count from `folder`.
        t: (n,) [s], when they were taken; the clock is that of the trajectory.
    """

    name: str
    folder: Path
    camera: Camera
    X_WC: Pose
    file_names: list[str]
    t: np.ndarray


@dataclass(frozen=True, eq=False)
class Episode(View):
    """One push of the object, seen by a camera that stands still, and maybe by others.

    An episode without a film has no images; its times are those of the object's poses, or of the pusher's log.

    Attributes:
        name: Name of its folder, `episodes/<name>` of the capture.
        trajectory: Poses of the pusher, from the first image to the last or longer.
        object_poses: Poses of the object; to score, and to fit by `identify --poses` alone. None where not known.
        others: Further cameras, `cameras/<name>` of the folder, in the order of their names.
        clock: How the images' clock was brought to the log's; None where `clock.yaml` is not there.
        start: Start from `start.yaml`; None for an object that rests where `capture.yaml` says.
    """

    trajectory: PusherTrajectory
    object_poses: ObjectPoses | None
    others: tuple[View, ...] = ()
    clock: EpisodeClock | None = None
    own_start: "Start | None" = None

    @property
    def start(self) -> Pose | None:
        """Pose X_WO at the start, q (4,), p (3,) [m], where it has one of its own."""
        return None if self.own_start is None else self.own_start.X_WO

    @property
    def start_velocity(self) -> torch.Tensor | None:
        """Velocity (6,) at the start, [rad/s; m/s] at O, of an object that is thrown; None for one at rest."""
        return None if self.own_start is None else self.own_start.V_WO

    @cached_property
    def views(self) -> tuple[View, ...]:
        """All cameras: that of the episode's own folder first."""
        return (View("", self.folder, self.camera, self.X_WC, self.file_names, self.t), *self.others)

    @property
    def times(self) -> np.ndarray:
        """Times [s] of the images of all cameras, camera by camera."""
        return np.concatenate([view.t for view in self.views])

    def require_film(self) -> None:
        """Raise InputError where the episode has no images."""
        if not self.file_names:
            raise InputError(self.folder, value=f"no {FRAMES_FILE}", allowed="a film, or `pinwm identify --poses`")

    def pusher_pose(self, time: float) -> Pose:
        """Pose X_WP of the pusher at a time [s]; see `pose_at`."""
        return pose_at(self.trajectory.t, self.trajectory.p_WP, self.trajectory.q_WP, time)


def pose_at(t: np.ndarray, p: np.ndarray, q: np.ndarray, time: float) -> Pose:
    """Pose at a time [s] between the rows of a table: straight in p, shortest in q; outside, that of the nearest row.

    Args:
        t: (n,) [s], increasing.
        p: (n, 3) [m].
        q: (n, 4), wxyz.
    """
    k = int(np.clip(np.searchsorted(t, time, side="right") - 1, 0, len(t) - 1))
    after = min(k + 1, len(t) - 1)
    share = 0.0 if after == k else float(np.clip((time - t[k]) / (t[after] - t[k]), 0.0, 1.0))
    turned = q[after] if q[k] @ q[after] >= 0 else -q[after]
    mixed, p_k = (1 - share) * q[k] + share * turned, (1 - share) * p[k] + share * p[after]
    return Pose(torch.from_numpy(mixed / np.linalg.norm(mixed)), torch.from_numpy(p_k))


def read_episode(capture: Capture | UnfinishedCapture, name: str) -> Episode:
    """Read an episode by its name; of its images, only whether they are there.

    One with neither `camera.json` nor `frames.csv` has no film.

    Raises:
        InputError: There is no such episode, a file is missing or unreadable, a table has other columns, a
            number is not finite or out of range, times do not increase, a quaternion is not of unit norm, an
            image is missing, or was taken before or after the pusher's log.
    """
    folder = capture.folder / EPISODES / name
    if name not in capture.episode_names:
        allowed = ", ".join(capture.episode_names) or "a capture with episodes"
        raise InputError(capture.folder / EPISODES, value=f"no episode {name!a}", allowed=allowed)
    trajectory = read_trajectory(folder)
    start, poses = read_start(folder), read_object_poses(folder)
    if not is_filmed(folder):
        t = trajectory.t if poses is None else poses.t
        return Episode(name, folder, _NO_CAMERA, _NOWHERE, [], t, trajectory, poses, own_start=start)
    folders = (folder, *sorted(path for path in (folder / CAMERAS).glob("*") if path.is_dir()))
    own, *others = (
        View(path.name, path, *read_fixed_camera(path), *read_frame_table(path, trajectory.t)) for path in folders
    )
    clock = read_clock(folder)
    own_all = {**vars(own), "trajectory": trajectory, "object_poses": poses}
    return Episode(**own_all, others=tuple(others), clock=clock, own_start=start)


def is_filmed(folder: Path) -> bool:
    """Flag: an episode's folder has a camera or a table of images."""
    return any(os.path.lexists(folder / name) for name in (CAMERA_FILE, FRAMES_FILE))


@dataclass(frozen=True, eq=False)
class Start:
    """Start of an object: pose q (4,), p (3,) [m], and velocity (6,) [rad/s; m/s] at O; None for one at rest."""

    X_WO: Pose
    V_WO: torch.Tensor | None


_Speed = Annotated[float, finite(-_FASTEST, _FASTEST)]


class _StartDocument(Document):
    X_WO: PoseDocument
    V_WO: Annotated[tuple[_Speed, _Speed, _Speed, _Speed, _Speed, _Speed], FromList] | None = None


def read_start(folder: Path) -> Start | None:
    """Return the start of an episode from its `start.yaml`; None where there is no such file.

    Raises:
        InputError: The file cannot be used.
    """
    path = folder / START_FILE
    if not os.path.lexists(path):
        return None
    document = read_yaml(path).read(_StartDocument)
    V_WO = None if document.V_WO is None else torch.tensor(document.V_WO, dtype=torch.float64)
    return Start(document.X_WO.pose(), V_WO)


def tell_doubts(episode: Episode) -> Episode:
    """Return an episode that is to be computed; a warning tells implausible times.

    Raises:
        InputError: The times are such that a computation would not end; the message proposes their unit.
    """
    for doubt in require_computable(episode.folder, episode.t if episode.file_names else None, episode.trajectory):
        warnings.warn(str(doubt), UserWarning, stacklevel=2)
    return episode


def read_episode_folder(folder: Path) -> tuple[Capture, Episode]:
    """Read an episode by its folder `.../episodes/<name>`, and the capture that it belongs to.

    Raises:
        InputError: The folder is not in the `episodes` of a capture, or one of the two is refused.
    """
    whole = folder.absolute()
    if whole.parent.name != EPISODES:
        raise InputError(folder, value="a folder outside of episodes/", allowed="CAPTURE/episodes/NAME")
    capture = load_capture(whole.parent.parent)
    return capture, read_episode(capture, whole.name)


def read_episode_image(folder: Path, name: str, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """One image of an episode.

    Returns:
        (H, W, 3) float32, sRGB in [0, 1], white where the object is not; and (H, W) bool, true on the object; nowhere
        true for an image that does not show it.

    Raises:
        InputError: The image or its mask is missing, unreadable or of another size than the camera's.
    """
    path = folder / name
    image, mask = read_image(path, find_mask(folder, path), may_be_empty=True)
    require_size(path, mask, camera, f"as {folder / CAMERA_FILE} says")
    return image, mask


def read_fixed_camera(folder: Path) -> tuple[Camera, Pose]:
    """Camera and its pose X_WC (OpenCV axes) from `camera.json`; raises InputError as `read_episode` does."""
    document = read_json(folder / CAMERA_FILE)
    require_known(document)
    return read_camera(document, document), read_pose(document["transform_matrix"])
