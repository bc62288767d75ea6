# SPDX-License-Identifier: MIT
"""Import of the data of PIN-WM's authors: pushes in Bullet, with masked images and static views.

    dynamic_train0.json     ee_init_position, ee_goal_position: (x, y) or (x, y, z) of the pusher [m]
                            image_datas: of each image c2w (3 x 4, OpenGL axes), intrinsic (3 x 3) and
                              file_path, `.../r_CAMERA_FRAME.png`; `.../m_CAMERA_FRAME.png` is its masked twin
                            pose_datas: optional; x, y, z, qx, qy, qz, qw of the object at each frame
    transforms_train.json   static views, as NeRF writes them

Frames are 1/24 s apart. At each the pusher's velocity becomes 5/s times the way that is left to the goal, in the
plane, and stays so until the next.

Source: Li et al., "PIN-WM" (2025); the layout is that of their released loader and training script.
"""

import re
import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from pinwm_drake.capture.episode_tables import ObjectPoses, PusherTrajectory
from pinwm_drake.capture.images import read_image, read_size, require_size
from pinwm_drake.capture.importers.nerfstudio import read_posed_images
from pinwm_drake.capture.importers.similarity import scaled_world
from pinwm_drake.capture.importers.target import Report, Scenery, copy_file, tell, unheard, write_scenery, write_static
from pinwm_drake.capture.paths import is_file, is_folder
from pinwm_drake.capture.scene import EPISODES
from pinwm_drake.capture.transforms import opencv_pose
from pinwm_drake.capture.units import position_doubts, time_doubts
from pinwm_drake.capture.write import write_episode_tables
from pinwm_drake.documents import Entry, read_json
from pinwm_drake.errors import InputError
from pinwm_drake.files import appearing
from pinwm_drake.geometry.meshes import load_mesh
from pinwm_drake.rendering.camera import Camera
from pinwm_drake.spatial.poses import Pose

_STATIC = ("transforms_train.json", "transforms.json")
_FILES = re.compile(r"dynamic_(train|test)(\d{1,5})\.json", re.ASCII)
RATE = 24.0  # Hz
_GAIN = 5.0  # 1/s
_IMAGE = re.compile(r"(.*/|)r_(\d{1,5})_(-?\d{1,5})(\.\w+)", re.ASCII)
_UNIT_NORM = 1e-3  # their poses are in single precision
_SAME = 1e-6  # how far a camera that stands still may move: m, or along an axis


@dataclass(frozen=True, eq=False)
class _Push:
    """Push of PIN-WM's authors: masked images and their frames, a camera that stands still, and both bodies."""

    images: list[Path]
    frames: list[int]
    camera: Camera
    X_WC: Pose
    trajectory: PusherTrajectory
    poses: ObjectPoses | None


def import_pinwm(
    source: Path,
    out: Path,
    scenery: Scenery,
    *,
    pusher_height: float | None = None,
    camera: int | None = None,
    static: Path | None = None,
    report: Report = unheard,
) -> list[str]:
    """Make a capture of a folder in the layout of PIN-WM's authors.

    Returns the files of the pushes, which become episodes 0000, 0001, ...

    Args:
        source: The folder.
        out: The capture; not there yet, or empty.
        scenery: Meshes and what else the data do not say; without X_WO, that of the first pose of the object.
        pusher_height: m, z of the pusher; None where the data have it.
        camera: Number of one of several cameras; None for the one with the lowest number.
        static: The static views' file; None for `transforms_train.json` or `transforms.json` in `source`.
        report: Called with the share of the images that are written.



    Raises:
        InputError: A file is missing or unreadable, a value is missing or out of range, a camera moves, or there
            is no pose of the object.
    """
    files = _push_files(source)
    views = read_posed_images(static or _static_file(source))
    pushes = [_read_push(path, pusher_height, camera) for path in files]
    with appearing(out) as folder:
        X_WO = scenery.X_WO or _first_pose(files[0], pushes[0])
        write_scenery(folder, scenery, X_WO)
        number = len(views) + sum(len(push.images) for push in pushes)
        write_static(
            folder, views, scaled_world(), scenery.mesh, X_WO, lambda share: report(share * len(views) / number)
        )
        done = len(views)
        mesh = load_mesh(scenery.mesh)
        for k, push in enumerate(pushes):
            tell(time_doubts(folder / EPISODES / f"{k:04}", np.array(push.frames) / RATE, push.trajectory))
            tell(position_doubts(folder / EPISODES / f"{k:04}", push.trajectory, mesh, X_WO, None))
            _write_push(folder / EPISODES / f"{k:04}", push)
            done += len(push.images)
            report(done / number)
    return [path.name for path in files]


def _push_files(source: Path) -> list[Path]:
    if not is_folder(source):
        raise InputError(source, value="no such folder", allowed="a folder with dynamic_train0.json")
    matches = ((path, _FILES.fullmatch(path.name)) for path in source.iterdir())
    found = [(match[1] == "test", int(match[2]), path) for path, match in matches if match]
    if not found:
        raise InputError(source, value="no dynamic_train*.json", allowed="a folder with dynamic_train0.json")
    return [path for *_, path in sorted(found)]


def _static_file(source: Path) -> Path:
    for name in _STATIC:
        if is_file(source / name):
            return source / name
    raise InputError(source, value="no " + " or ".join(_STATIC), allowed="static views, or --static FILE")


def _first_pose(path: Path, push: _Push) -> Pose:
    if push.poses is None:
        raise InputError(path, value="no pose_datas", allowed="poses of the object, or --pose for where it starts")
    return Pose(torch.tensor(push.poses.q_WO[0]), torch.tensor(push.poses.p_WO[0]))


def _write_push(folder: Path, push: _Push) -> None:
    names = [f"rgb/{frame:05}{path.suffix.lower()}" for frame, path in zip(push.frames, push.images, strict=True)]
    for path, name in zip(push.images, names, strict=True):
        require_size(path, read_image(path, may_be_empty=True)[1], push.camera, "as its camera has")
        copy_file(path, folder / name)
    t = np.array(push.frames) / RATE
    write_episode_tables(folder, push.camera, push.X_WC, names, t, push.trajectory, push.poses)


def _read_push(path: Path, pusher_height: float | None, camera: int | None) -> _Push:
    document = read_json(path)
    entries = _chosen(document["image_datas"], camera)
    frames = sorted(entries)
    first = entries[frames[0]]
    X_WC, intrinsics = _pose(first), _intrinsics(first)
    images = [_masked(entries[frame]) for frame in frames]
    for frame in frames:
        _require_still(entries[frame], X_WC, intrinsics)
    width, height = read_size(images[0])
    if abs(float(intrinsics[2])) > 10 * width or abs(float(intrinsics[3])) > 10 * height:
        raise first["intrinsic"].refusal("a principal point near the image")
    start, goal = (_position(document[key], pusher_height) for key in ("ee_init_position", "ee_goal_position"))
    motion = trajectory(start, goal, frames[-1] + 1)
    return _Push(images, frames, Camera(width, height, intrinsics), X_WC, motion, _object_poses(document))


def trajectory(start: np.ndarray, goal: np.ndarray, count: int) -> PusherTrajectory:
    """Motion of the pusher in a push of PIN-WM's authors.

    Args:
        start: (3,) [m], position at frame 0.
        goal: (3,) [m], position aimed at; its height does not count.
        count: Number of frames.
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
    if len(cameras) > 1 and camera is None:
        warnings.warn(f"{images.path}: cameras {sorted(cameras)}, of which {number} is imported", stacklevel=2)
    if number not in cameras:
        raise images.refusal(f"one of the cameras {sorted(cameras)}", f"no image of camera {number}")
    return cameras[number]


def _masked(entry: Entry) -> Path:
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
