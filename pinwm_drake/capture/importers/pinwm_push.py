"""Pushes in the layout of PIN-WM's authors; see `pinwm` for the layout."""

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from pinwm_drake.capture.episode_tables import ObjectPoses, PusherTrajectory
from pinwm_drake.capture.images import read_size
from pinwm_drake.capture.paths import is_file
from pinwm_drake.capture.transforms import opencv_pose
from pinwm_drake.documents import Entry, read_json
from pinwm_drake.errors import InputError
from pinwm_drake.rendering.camera import Camera
from pinwm_drake.spatial.poses import Pose

RATE = 24.0  # Hz
_GAIN = 5.0  # 1/s
_IMAGE = re.compile(r"(.*/|)r_(\d{1,5})_(-?\d{1,5})(\.\w+)", re.ASCII)
_UNIT_NORM = 1e-3  # their poses are in single precision
_SAME = 1e-6  # how far a camera that stands still may move: m, or along an axis


@dataclass(frozen=True, eq=False)
class ReleasedPush:
    """Push of PIN-WM's authors.

    Attributes:
        images: Paths of the masked images, by frame.
        frames: Number of each frame.
        camera: Camera of all images; size and intrinsics (4,).
        X_WC: Pose of the camera (OpenCV axes); q (4,), p (3,) [m].
        trajectory: Motion of the pusher, from frame 0 to the last.
        poses: Poses of the object, by frame; or None.
    """

    images: list[Path]
    frames: list[int]
    camera: Camera
    X_WC: Pose
    trajectory: PusherTrajectory
    poses: ObjectPoses | None


def read_push(path: Path, *, pusher_height: float | None = None, camera: int | None = None) -> ReleasedPush:
    """Reads a push from its `dynamic_train*.json`.

    Args:
        path: The file; paths of images count from its folder.
        pusher_height: Height of the pusher, as for `import_pinwm`.
        camera: Number of the camera, as for `import_pinwm`.

    Returns:
        The push.

    Raises:
        InputError: See `import_pinwm`.
    """
    document = read_json(path)
    entries = _chosen(document["image_datas"], camera)
    first = entries[min(entries)]
    X_WC, intrinsics = _pose(first), _intrinsics(first)
    images = []
    for _, entry in sorted(entries.items()):
        images.append(_masked(entry))
        _require_still(entry, X_WC, intrinsics)
    width, height = read_size(images[0])
    if abs(float(intrinsics[2])) > 10 * width or abs(float(intrinsics[3])) > 10 * height:
        raise first["intrinsic"].refusal("a principal point near the image")
    frames = sorted(entries)
    start, goal = (_position(document[key], pusher_height) for key in ("ee_init_position", "ee_goal_position"))
    return ReleasedPush(
        images=images,
        frames=frames,
        camera=Camera(width, height, intrinsics),
        X_WC=X_WC,
        trajectory=trajectory(start, goal, frames[-1] + 1),
        poses=_object_poses(document),
    )


def trajectory(start: np.ndarray, goal: np.ndarray, count: int) -> PusherTrajectory:
    """Motion of the pusher in a push of PIN-WM's authors.

    Args:
        start: (3,) [m], position at frame 0.
        goal: (3,) [m], position aimed at; its height does not count.
        count: Number of frames.

    Returns:
        Pose of the pusher at each frame, and its velocity from there to the next.
    """
    p_WP, v_WP = np.zeros((count, 3)), np.zeros((count, 3))
    p = start.copy()
    for k in range(count):
        p_WP[k] = p
        v_WP[k, :2] = _GAIN * (goal - p)[:2]
        p = p + v_WP[k] / RATE
    return PusherTrajectory(np.arange(count) / RATE, p_WP, np.tile([1.0, 0.0, 0.0, 0.0], (count, 1)), v_WP, None)


def _chosen(images: Entry, camera: int | None) -> dict[int, Entry]:
    """Images of one camera, by frame; those before frame 0 are left out, as the authors' loader does."""
    cameras: dict[int, dict[int, Entry]] = {}
    for entry in images.items():
        name = entry["file_path"]
        match = _IMAGE.fullmatch(name.text())
        if match is None:
            raise name.refusal("r_CAMERA_FRAME.png, in a folder or not")
        if int(match[3]) < 0:
            continue
        frames = cameras.setdefault(int(match[2]), {})
        if int(match[3]) in frames:
            raise name.refusal("each image once")
        frames[int(match[3])] = entry
    if not cameras:
        raise images.refusal("an image of frame 0 or later", "none")
    number = min(cameras) if camera is None else camera
    if number not in cameras:
        raise images.refusal(f"one of the cameras {sorted(cameras)}", f"no image of camera {number}")
    return cameras[number]


def _masked(entry: Entry) -> Path:
    """Path of the masked twin of an image."""
    match = _IMAGE.fullmatch(entry["file_path"].text())
    assert match is not None  # `_chosen` has refused other names
    path = entry.path.parent / f"{match[1]}m_{match[2]}_{match[3]}{match[4]}"
    if not is_file(path):
        raise InputError(path, value="no such file", allowed=f"the masked twin of {entry['file_path'].text()}")
    return path


def _pose(entry: Entry) -> Pose:
    c2w = entry["c2w"]
    rows = 4 if isinstance(c2w.value, list) and len(c2w.value) == 4 else 3
    matrix = np.eye(4)
    matrix[:rows] = c2w.numbers(rows, 4)
    return opencv_pose(c2w, matrix)


def _intrinsics(entry: Entry) -> torch.Tensor:
    intrinsic = entry["intrinsic"]
    matrix = intrinsic.numbers(3, 3)
    if min(matrix[0, 0], matrix[1, 1]) < 1e-3 or max(matrix[0, 0], matrix[1, 1]) > 1e9:
        raise intrinsic.refusal("positive focal lengths, px")
    if abs(matrix[0, 1]) > 1e-6 or not np.allclose(matrix[2], [0, 0, 1]) or matrix[1, 0] != 0:
        raise intrinsic.refusal("(fx, 0, cx), (0, fy, cy), (0, 0, 1)")
    return torch.tensor([matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]], dtype=torch.float64)


def _require_still(entry: Entry, X_WC: Pose, intrinsics: torch.Tensor) -> None:
    """Requires the camera of an image to be that of the first one; raises InputError otherwise."""
    own = _pose(entry)
    still = torch.allclose(own.p, X_WC.p, rtol=0, atol=_SAME) and float((own.q @ X_WC.q).abs()) > 1 - _SAME
    if not still:
        raise entry["c2w"].refusal("a camera that stands still during a push", "another pose than before")
    if not torch.allclose(_intrinsics(entry), intrinsics, rtol=1e-9):
        raise entry["intrinsic"].refusal("one camera for all images", "other intrinsics than before")


def _position(entry: Entry, height: float | None) -> np.ndarray:
    """Position of the pusher (3,) [m], its height from the option where there is one."""
    flat = isinstance(entry.value, list) and len(entry.value) == 2
    position = entry.numbers(2 if flat else 3)
    if np.abs(position).max() > 1e3:
        raise entry.refusal("metres")
    if height is None and flat:
        raise entry.refusal("three numbers, or --pusher-height for the third")
    return np.array([position[0], position[1], position[2] if height is None else height])


def _object_poses(document: Entry) -> ObjectPoses | None:
    poses = document.find("pose_datas")
    if poses is None or poses.value is None:
        return None
    rows = []
    for entry in poses.items():
        row = entry.numbers(7)
        with np.errstate(over="ignore"):
            norm = float(np.linalg.norm(row[3:]))
        if abs(norm - 1) > _UNIT_NORM or np.abs(row[:3]).max() > 1e3:
            raise entry.refusal("x, y, z, and qx, qy, qz, qw of norm 1")
        rows.append([*row[:3], *(row[[6, 3, 4, 5]] / norm)])
    values = np.array(rows)
    return ObjectPoses(np.arange(len(rows)) / RATE, values[:, :3], values[:, 3:])
