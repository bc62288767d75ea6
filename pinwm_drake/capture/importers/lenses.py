# SPDX-License-Identifier: MIT
"""Lenses of the formats of others, and images that are freed from their distortion."""

from pathlib import Path

import numpy as np
import torch
from PIL import Image

from pinwm_drake.capture.images import read_pixels
from pinwm_drake.capture.lens import Lens
from pinwm_drake.capture.remap import Remap, whole_view
from pinwm_drake.documents import Entry
from pinwm_drake.errors import InputError
from pinwm_drake.files import prepare_folder, replacing
from pinwm_drake.rendering.camera import Camera

# COLMAP's camera models by the numbers of its binary files: names of their parameters; None where it is not obeyed.
COLMAP_MODELS: tuple[tuple[str, int, tuple[str, ...] | None], ...] = (
    ("SIMPLE_PINHOLE", 3, ()),
    ("PINHOLE", 4, ()),
    ("SIMPLE_RADIAL", 4, ("k1",)),
    ("RADIAL", 5, ("k1", "k2")),
    ("OPENCV", 8, ("k1", "k2", "p1", "p2")),
    ("OPENCV_FISHEYE", 8, ("k1", "k2", "k3", "k4")),
    ("FULL_OPENCV", 12, ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")),
    ("FOV", 5, None),
    ("SIMPLE_RADIAL_FISHEYE", 4, ("k1",)),
    ("RADIAL_FISHEYE", 5, ("k1", "k2")),
    ("THIN_PRISM_FISHEYE", 12, None),
)
COLMAP_OBEYED = ", ".join(name for name, _, keys in COLMAP_MODELS if keys is not None)
_FARTHEST, _STRONGEST = 1e9, 1e3  # px, and of a number of distortion
_NERFSTUDIO = ("k1", "k2", "p1", "p2", "k3")
_FISHEYE = ("k1", "k2", "k3", "k4")
OBEYED = frozenset((*_NERFSTUDIO, *_FISHEYE, "is_fisheye"))
_UNDISTORT = "undistort the images first"


def colmap_camera(path: Path, row: int, model: str, values: list[float]) -> tuple[Camera, Lens | None]:
    """Camera of a COLMAP model, with its lens where it has distortion.

    Args:
        path, row: File and record, for messages.
        model: Name of the camera model.
        values: Width, height and parameters, px.

    Raises:
        InputError: The model is not obeyed, or a number is out of range.
    """
    known = {name: (count, keys) for name, count, keys in COLMAP_MODELS}
    count, keys = known.get(model, (0, None))
    if keys is None:
        raise InputError(
            path, row=row, value=f"camera model {ascii(model)[1:-1][:40]}", allowed=f"{COLMAP_OBEYED}; {_UNDISTORT}"
        )
    width, height, *parameters = values
    if len(parameters) != count:
        raise InputError(
            path, row=row, value=f"{len(parameters)} parameters", allowed=f"{count} parameters for {model}"
        )
    *focal, cx, cy = parameters[: count - len(keys)]
    numbers = dict(zip(keys, parameters[count - len(keys) :], strict=True))
    bounds = [("width", width, 1.0, 16384.0), ("height", height, 1.0, 16384.0)]
    bounds += [("focal length", value, 1e-3, _FARTHEST) for value in focal]
    bounds += [("principal point", value, -1e6, 1e6) for value in (cx, cy)]
    for name, value, low, high in bounds:
        if not low <= value <= high or (low == 1.0 and value != int(value)):
            raise InputError(path, row=row, value=f"{name} {value:g} px", allowed="a camera of 1 to 16384 px")
    for name, value in numbers.items():
        if abs(value) > _STRONGEST:
            raise InputError(path, row=row, value=f"{name} = {value:g}", allowed=f"a distortion up to {_STRONGEST:g}")
    intrinsics = torch.tensor([focal[0], focal[-1], cx, cy], dtype=torch.float64)
    camera = Camera(int(width), int(height), intrinsics)
    return camera, _lens(camera, numbers, "FISHEYE" in model)


def nerfstudio_lens(entry: Entry, camera: Camera) -> Lens | None:
    """Lens of a frame of a `transforms.json`, with the file's keys; None for a pinhole.

    Raises:
        InputError: A key is not obeyed by its camera model; the message names it.
    """
    model = entry.find("camera_model")
    name = None if model is None else model.text()
    told = entry.find("is_fisheye")
    fisheye = name == "OPENCV_FISHEYE" or (told is not None and bool(told.value))
    if told is not None and told.value not in (None, True, False):
        raise told.refusal("true or false")
    if told is not None and told.value and name not in (None, "OPENCV_FISHEYE"):
        raise told.refusal(f"false, as camera_model {name} says")
    keys = _FISHEYE if fisheye else _NERFSTUDIO
    numbers = {}
    for key in OBEYED - {"is_fisheye"}:
        own = entry.find(key)
        if own is None or own.value is None:
            continue
        value = own.number(-_STRONGEST, _STRONGEST)
        if value and (key not in keys or name == "PINHOLE"):
            raise own.refusal(f"0: camera model {name or ('OPENCV_FISHEYE' if fisheye else 'OPENCV')}; {_UNDISTORT}")
        numbers[key] = value
    return _lens(camera, numbers, fisheye)


def _lens(camera: Camera, numbers: dict[str, float], fisheye: bool) -> Lens | None:
    """Lens of a camera by its numbers of distortion; None where there is none."""
    if not fisheye and not any(numbers.values()):
        return None
    keys = _FISHEYE if fisheye else (*_NERFSTUDIO, "k4", "k5", "k6") if "k6" in numbers else _NERFSTUDIO
    distortion = np.array([numbers.get(key, 0.0) for key in keys])
    intrinsics = camera.intrinsics.numpy()
    return Lens(camera.width, camera.height, "fisheye" if fisheye else "opencv", intrinsics, distortion)


def write_undistorted(
    path: Path, lens: Lens, mask: np.ndarray, target: Path, mask_target: Path | None
) -> tuple[Camera, np.ndarray]:
    """Write an image as a pinhole at its place would show it, and its mask.

    Args:
        path: File of the image.
        lens: The lens that took it.
        mask: (height, width) bool, true on the object.
        target: File to write, PNG.
        mask_target: File of the mask to write, PNG; None for alpha in place of one.

    Returns:
        The pinhole, which shows all of the object, and the mask in it, (height, width) bool.

    Raises:
        InputError: The image cannot be read, or a file cannot be written.
    """
    pixels = read_pixels(path)
    camera = whole_view(lens, mask)
    remap = Remap(lens, camera)
    seen = remap.mask(mask)
    if mask_target is not None:
        _write(target, remap(np.ascontiguousarray(pixels[..., :3])))
        _write(mask_target, 255 * seen.astype(np.uint8))
        return camera, seen
    alpha = pixels[..., 3].astype(np.float32)
    if pixels[..., 3].min() == 255:  # it stands on white, and keeps its colours
        alpha = 255.0 * mask.astype(np.float32)
        colour = remap(np.ascontiguousarray(pixels[..., :3])).astype(np.float32)
        share = remap(alpha, outside=0)
    else:  # colours count by their alpha
        share = remap(alpha, outside=0)
        colour = remap(pixels[..., :3] * alpha[..., None], outside=0) / np.maximum(share, 1e-3)[..., None]
    whole = np.concatenate([colour, share[..., None]], -1)
    _write(target, np.clip(np.round(whole), 0, 255).astype(np.uint8))
    return camera, seen


def _write(path: Path, pixels: np.ndarray) -> None:
    prepare_folder(path.parent)
    with replacing(path) as temporary:
        Image.fromarray(pixels).save(temporary)
