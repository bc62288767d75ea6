# SPDX-License-Identifier: MIT
"""Cameras and their poses, read from the `transforms.json` of nerfstudio.

nerfstudio writes poses of cameras in the world with OpenGL's axes (x right, y up, z backward). They become
OpenCV's (x right, y down, z forward) here, and nowhere else.
"""

import math
import os
import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from pinwm_drake.capture.refusals import Refuse, raise_it
from pinwm_drake.capture.scene import FARTHEST
from pinwm_drake.documents import Entry, read_json
from pinwm_drake.errors import InputError
from pinwm_drake.rendering.camera import Camera
from pinwm_drake.spatial.poses import Pose
from pinwm_drake.spatial.rotations import matrix_to_quaternion

# How far a rotation matrix may be from orthonormal: six printed digits leave 1e-6, single precision 1e-7.
_ORTHONORMAL = 1e-4
MAX_SIZE = 16384  # px, that of Camera
_MODELS = ("PINHOLE", "OPENCV")
_LENSES = (*_MODELS, "OPENCV_FISHEYE")
# Keys that are read, those that may only say that there is nothing to obey, and those without a meaning for the camera.
_READ = {
    "camera_model", "w", "h", "fl_x", "fl_y", "cx", "cy", "camera_angle_x", "camera_angle_y",
    "frames", "file_path", "mask_path", "transform_matrix",
}  # fmt: skip
_DISTORTIONS = ("k1", "k2", "k3", "k4", "k5", "k6", "p1", "p2", "distortion_params", "rolling_shutter", "skew")
_FALSE = ("is_fisheye", "fisheye", "latlong", "equirectangular")
_UNMOVED = {"scale": 1.0, "offset": 0.0}  # of instant-ngp
_MOVED = ("applied_transform", "applied_scale")  # of nerfstudio: how its world came from that of COLMAP
_IGNORED = {
    "aabb", "aabb_scale", "render_aabb", "ply_file_path", "train_filenames", "val_filenames", "test_filenames",
    "orientation_override", "auto_scale_poses_override", "colmap_im_id", "depth_file_path", "normal_file_path",
    "semantic_file_path", "sharpness", "rotation", "up", "time", "timestamp", "id", "name", "comment", "description",
    "author", "license", "date", "version",
}  # fmt: skip
_ANGLES = {"fl_x": ("camera_angle_x", 0), "fl_y": ("camera_angle_y", 1)}
_ANGLE = 1e-3  # rad, the narrowest angle of view
_SAME_FOCAL = 0.01  # of a focal length, between two ways to say it


@dataclass(frozen=True, eq=False)
class Frame:
    """One posed image of a `transforms.json`."""

    entry: Entry  # for error messages
    file_path: str  # the image, as written in the file
    image_path: Path
    mask_path: Path | None  # as the file names it, or None
    camera: Camera
    X_WC: Pose  # of the camera in the world, OpenCV axes; q (4,), p (3,) [m]


def read_transforms(path: Path) -> list[Frame]:
    """Read the frames of a `transforms.json`, in its order.

    Intrinsics of a frame replace those of the file.

    Args:
        path: The file. Image paths count from its folder.

    Raises:
        InputError: A key is missing or not obeyed, a number is not finite or out of range, a camera model is another
            than PINHOLE or OPENCV without distortion, a matrix is not rigid, or an image is listed twice.
    """
    document = read_json(path)
    require_known(document)
    frames = [read_frame(document, entry) for entry in document["frames"].items()]
    require_different(frames)
    return frames


def require_known(entry: Entry, obeyed: frozenset[str] = frozenset()) -> None:
    """Require a file or frame without keys that would change the camera and are not obeyed.

    A key that says how nerfstudio has moved the world causes a warning, as the poses stay as they are. Keys of the lens
    in `obeyed` are left to the caller.

    Raises:
        InputError: A key is unknown, or of a camera with distortion, of a fisheye, or of another world.
    """
    if not isinstance(entry.value, dict):
        raise entry.refusal("a mapping with keys")
    for key in entry.value:
        own = entry[key]
        if own.value is None or key in _READ or key in _IGNORED or key in obeyed:
            continue
        if key in _DISTORTIONS:
            _require_all(own, 0.0, "0: undistort the images first")
        elif key in _FALSE:
            if own.value is not False and own.value != 0:
                raise own.refusal("false: a pinhole camera; undistort the images first")
        elif key in _UNMOVED:
            _require_all(own, _UNMOVED[key], f"{_UNMOVED[key]:g}: the world is that of the matrices; delete this key")
        elif key in _MOVED:
            warnings.warn(
                f"{entry.path}: {own.place} is not undone: the world is that of the matrices", UserWarning, stacklevel=2
            )
        else:
            where = f" under {entry.place}" if entry.place else ""
            allowed = "keys that are obeyed (see docs/reference/formats/capture.md); delete it if the camera is right"
            raise InputError(entry.path, value=f"an unknown key {ascii(key)[:60]}{where}", allowed=allowed)


def _require_all(entry: Entry, value: float, allowed: str) -> None:
    numbers = entry.items() if isinstance(entry.value, list) and entry.value else [entry]
    if entry.value != [] and any(number.number() != value for number in numbers):
        raise entry.refusal(allowed)


def require_different(frames: list[Frame], refuse: Refuse = raise_it) -> None:
    """Require each frame to have an image of its own; `refuse` receives each problem, an InputError."""
    seen: dict[str, str] = {}
    for frame in frames:
        other = seen.setdefault(os.path.realpath(frame.image_path), frame.entry.place)
        if other != frame.entry.place:
            refuse(frame.entry["file_path"].refusal(f"each image once (it is in {other} too)"))


def read_frame(
    document: Entry, frame: Entry, farthest: float = FARTHEST, obeyed: frozenset[str] = frozenset()
) -> Frame:
    """One frame; `document` holds what is not in the frame itself.

    Cameras are within `farthest` of the origin, in the file's unit. Keys of the lens in `obeyed` are left to the
    caller. Raises InputError as `read_transforms` does.
    """
    require_known(frame, obeyed)
    file_path = frame["file_path"].text()
    mask_path = frame.find("mask_path")
    folder = frame.path.parent
    return Frame(
        entry=frame,
        file_path=file_path,
        image_path=folder / file_path,
        mask_path=None if mask_path is None else folder / mask_path.text(),
        camera=read_camera(document, frame, _LENSES if obeyed else _MODELS),
        X_WC=read_pose(frame["transform_matrix"], farthest),
    )


def read_camera(document: Entry, frame: Entry, models: tuple[str, ...] = _MODELS) -> Camera:
    """Size and intrinsics [px], the frame's own before the document's; raises InputError as `read_transforms` does."""

    # By `Entry`: a frame's keys stand in for the file's, and the bounds of cx and cy are those of w and h.
    def find(key: str) -> Entry:
        return frame.find(key) or document[key]

    model = frame.find("camera_model") or document.find("camera_model")
    if model is not None and model.text() not in models:
        raise model.refusal(", ".join(models) if models is _LENSES else " or ".join(models) + " without distortion")
    width, height = (find(key).integer(1, MAX_SIZE) for key in ("w", "h"))
    bounds = {"fl_x": (1e-3, 1e9), "fl_y": (1e-3, 1e9), "cx": (-10.0 * width, 10.0 * width)}
    bounds["cy"] = -10.0 * height, 10.0 * height
    intrinsics = [find(key).number(*allowed) for key, allowed in bounds.items()]
    for focal, (key, axis) in _ANGLES.items():
        angle = frame.find(key) or (None if frame.find(focal) else document.find(key))
        own, said = intrinsics[axis], None if angle is None else focal_length(angle, (width, height)[axis])
        if angle is not None and said is not None and abs(said / own - 1) > _SAME_FOCAL:
            allowed = f"{2 * math.atan(0.5 * (width, height)[axis] / own):.6g} rad, as {focal} = {own:.6g} px says"
            raise angle.refusal(f"{allowed}, or one of the two keys")
    return Camera(width, height, torch.tensor(intrinsics, dtype=torch.float64))


def focal_length(angle: Entry, size: int) -> float:
    """Focal length [px] of a full angle of view [rad] across an image of `size` px; InputError where it is none."""
    value = angle.number()
    if not _ANGLE <= value <= math.pi - _ANGLE:
        in_degrees = _ANGLE <= math.radians(value) <= math.pi - _ANGLE
        hint = f"; are these degrees? {math.radians(value):.4g} rad" if in_degrees else ""
        raise angle.refusal(f"radians, {_ANGLE:g} to {math.pi - _ANGLE:.4g}{hint}")
    return 0.5 * size / math.tan(0.5 * value)


def require_last_row(entry: Entry, matrix: np.ndarray) -> None:
    """Require the last row of a transform (4, 4) to be 0, 0, 0, 1; raise InputError otherwise."""
    if not np.allclose(matrix[3], [0, 0, 0, 1], rtol=0, atol=1e-9):
        raise entry.refusal("a matrix whose last row is 0, 0, 0, 1", f"last row {matrix[3].tolist()}")


def read_pose(entry: Entry, farthest: float = FARTHEST) -> Pose:
    """Return a camera's pose in OpenCV axes from a 4 x 4 matrix [m] in OpenGL axes; errors as `opencv_pose`."""
    return opencv_pose(entry, entry.numbers(4, 4), farthest)


def opencv_pose(entry: Entry, matrix: np.ndarray, farthest: float = FARTHEST) -> Pose:
    """Return a camera's pose in OpenCV axes from the finite matrix (4, 4) [m] of an entry, in OpenGL axes.

    Raises:
        InputError: It is not a rigid transform, or farther away than `farthest` [m].
    """
    rotation = matrix[:3, :3]
    require_last_row(entry, matrix)
    with np.errstate(over="ignore", invalid="ignore"):
        error = float(np.abs(rotation.T @ rotation - np.eye(3)).max())
    if not error <= _ORTHONORMAL:  # NaN too
        allowed = f"a rigid transform: axes orthonormal to {_ORTHONORMAL:g}"
        raise entry.refusal(allowed, f"a matrix with axes {error:.2g} off")
    if np.linalg.det(rotation) < 0:
        raise entry.refusal("a rotation with determinant +1", "a reflection, determinant -1")
    if np.abs(matrix[:3, 3]).max() > farthest:
        raise entry.refusal(f"a camera within {farthest:g} m of the origin", f"position {matrix[:3, 3].tolist()}")
    R_WC = rotation @ np.diag([1.0, -1.0, -1.0])
    return Pose(matrix_to_quaternion(torch.from_numpy(R_WC)), torch.from_numpy(matrix[:3, 3].copy()))
