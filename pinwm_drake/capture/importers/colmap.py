# SPDX-License-Identifier: MIT
"""Import of COLMAP's sparse models, text or binary, with their images.

COLMAP gives the world in the camera's axes (x right, y down, z forward), X_CS; it becomes X_SC here. Its pixel
(0, 0) covers the square from 0 to 1, as ours does.

pycolmap 4.2 was tried in place of this reader. It needs `points3D` too, names neither file nor line of an error, reads
some truncated and damaged files without one, and takes 135 MB.
"""

import math
import struct
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from pinwm_drake.capture.episode_tables import quote
from pinwm_drake.capture.importers.similarity import Similarity
from pinwm_drake.capture.importers.target import PosedImage, Report, Scenery, unheard, write_scenery, write_static
from pinwm_drake.capture.paths import is_file, is_folder, require_file
from pinwm_drake.errors import InputError
from pinwm_drake.files import appearing
from pinwm_drake.reading.contents import read_bytes, read_text
from pinwm_drake.rendering.camera import Camera
from pinwm_drake.spatial.poses import Pose, identity, inverse

_MODEL_FOLDERS = ("", "sparse/0", "sparse", "0")
_MODEL_FILES = ("images.bin", "images.txt")
# Names and numbers of parameters of COLMAP's camera models, by the number that its binary files have.
_MODELS = (
    *(("SIMPLE_PINHOLE", 3), ("PINHOLE", 4), ("SIMPLE_RADIAL", 4), ("RADIAL", 5), ("OPENCV", 8), ("OPENCV_FISHEYE", 8)),
    *(("FULL_OPENCV", 12), ("FOV", 5), ("SIMPLE_RADIAL_FISHEYE", 4), ("RADIAL_FISHEYE", 5), ("THIN_PRISM_FISHEYE", 12)),
)
_PINHOLES = dict(_MODELS[:2])
_UNIT_NORM = 1e-3
_FARTHEST = 1e9


def import_colmap(
    source: Path,
    out: Path,
    scenery: Scenery,
    similarity: Similarity,
    *,
    images: Path | None = None,
    masks: Path | None = None,
    report: Report = unheard,
) -> int:
    """Make a capture of a COLMAP model: static views, without episodes. Returns how many views there are.

    Args:
        source: The model, or a folder with the model in `sparse/0` and its images in `images`.
        out: The capture; not there yet, or empty.
        scenery: The parts of the scene that the model does not have.
        similarity: Similarity from the model's world, whose origin, axes and unit are arbitrary, to the capture's.
        images: Folder of the images; None for `images` in `source` or beside the model.
        masks: Folder of the masks, as `NAME.png` for an image `NAME`, or with its name up to the suffix; None
            where the images have alpha or a white background.
        report: Called with the share of the images that are written.

    Raises:
        InputError: The model, an image or a mesh is refused; see `read_model` and `read_image`.
    """
    model = _model_folder(source)
    folder = images or _image_folder(source, model)
    posed = [_posed(image, folder, masks) for image in read_model(model)]
    with appearing(out) as capture:
        write_scenery(capture, scenery, scenery.X_WO or identity())
        write_static(capture, posed, similarity, report)
    return len(posed)


def _model_folder(source: Path) -> Path:
    for name in _MODEL_FOLDERS:
        if any(is_file(source / name / file) for file in _MODEL_FILES):
            return source / name
    found = "a folder without images.bin or images.txt" if is_folder(source) else "no such folder"
    raise InputError(source, value=found, allowed="a COLMAP model, or a folder with one in sparse/0")


def _image_folder(source: Path, model: Path) -> Path:
    for folder in (source / "images", model / "images", model.parent / "images", model.parent.parent / "images"):
        if is_folder(folder):
            return folder
    raise InputError(source / "images", value="no such folder", allowed="the images, or --images DIR")


def _posed(image: PosedImage, images: Path, masks: Path | None) -> PosedImage:
    path, mask = require_file(images / image.path, "the image that the model names"), None
    if masks is not None:
        names = [masks / f"{image.path}.png", (masks / image.path).with_suffix(".png")]
        mask = next((name for name in names if is_file(name)), None)
        if mask is None:
            raise InputError(names[0], value="no such file", allowed=f"the mask of {image.path}")
    return replace(image, path=path, mask_path=mask)


def read_model(folder: Path) -> list[PosedImage]:
    """Images of a COLMAP model in the order of their paths, which count from the folder of the images; no masks.

    Args:
        folder: Folder with `cameras.bin` and `images.bin`, or else `cameras.txt` and `images.txt`.

    Raises:
        InputError: A file is missing, truncated or wrong, or a camera is neither PINHOLE nor SIMPLE_PINHOLE.
    """
    if is_file(folder / "images.bin") and is_file(folder / "cameras.bin"):
        path = folder / "images.bin"
        images = _read_binary_images(path, _read_binary_cameras(folder / "cameras.bin"))
    else:
        path = folder / "images.txt"
        images = _read_text_images(path, _read_text_cameras(folder / "cameras.txt"))
    if not images:
        raise InputError(path, value="no image", allowed="a model with one image or more")
    return sorted(images, key=lambda image: str(image.path))


def _read_text_cameras(path: Path) -> dict[int, Camera]:
    cameras: dict[int, Camera] = {}
    for row, line in enumerate(read_text(path).splitlines(), start=1):
        cells = line.split()
        if not cells or cells[0].startswith("#"):
            continue
        number, *values = _numbers(path, row, cells[:1] + cells[2:])
        if len(cells) < 4:
            raise InputError(path, row=row, value=quote(line), allowed="CAMERA_ID MODEL WIDTH HEIGHT PARAMS[]")
        if int(number) in cameras:
            raise InputError(path, row=row, value=f"camera {int(number)} again", allowed="each camera once")
        cameras[int(number)] = _camera(path, row, cells[1], values)
    return cameras


def _read_text_images(path: Path, cameras: dict[int, Camera]) -> list[PosedImage]:
    images = []
    expected = "IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME, then a line of points"
    lines = iter(enumerate(read_text(path).splitlines(), start=1))
    for row, line in lines:
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        cells = line.split(maxsplit=9)
        if len(cells) < 10:
            raise InputError(path, row=row, value=quote(line), allowed=expected)
        values = _numbers(path, row, cells[1:9])
        images.append(_image(path, row, cells[9].strip(), int(values[7]), values[:7], cameras))
        next(lines, None)  # its points, of which there may be none
    return images


class _Binary:
    """Bytes of a file, little-endian and without padding, and the place up to which they have been read."""

    def __init__(self, path: Path) -> None:
        self.path = require_file(path, "a binary file")
        self.data, self.at = read_bytes(path), 0

    def take(self, code: str, row: int | None = None) -> tuple[Any, ...]:
        """Take the next values, by their `struct` format; raise InputError where the file ends before."""
        size = struct.calcsize(f"<{code}")
        if self.at + size > len(self.data):
            found = f"a file that ends after {len(self.data)} bytes"
            raise InputError(self.path, row=row, value=found, allowed="a whole file (the row is the record's number)")
        self.at += size
        return struct.unpack_from(f"<{code}", self.data, self.at - size)

    def count(self, row: int | None = None) -> int:
        """Return the number of the records that follow; no more than there are bytes."""
        return min(int(self.take("Q", row)[0]), len(self.data) + 1)


def _read_binary_cameras(path: Path) -> dict[int, Camera]:
    data, cameras = _Binary(path), {}
    for row in range(1, data.count() + 1):
        number, model, width, height = data.take("iiQQ", row)
        if not 0 <= model < len(_MODELS):
            raise InputError(path, row=row, value=f"camera model {model}", allowed="PINHOLE or SIMPLE_PINHOLE")
        name, count = _MODELS[model]
        cameras[number] = _camera(path, row, name, [width, height, *data.take(f"{count}d", row)])
    return cameras


def _read_binary_images(path: Path, cameras: dict[int, Camera]) -> list[PosedImage]:
    data, images = _Binary(path), []
    for row in range(1, data.count() + 1):
        _, *values, camera = data.take("i7di", row)
        end = data.data.find(b"\0", data.at)
        length = (len(data.data) if end < 0 else end) - data.at
        name = data.take(f"{length}sx", row)[0].decode("utf-8", errors="backslashreplace")
        data.take(f"{24 * data.count(row)}x", row)  # its points
        images.append(_image(path, row, name, camera, values, cameras))
    return images


def _numbers(path: Path, row: int, cells: list[str]) -> list[float]:
    values = []
    for cell in cells:
        try:
            values.append(float(cell))
        except ValueError:
            values.append(math.nan)
        if not abs(values[-1]) <= _FARTHEST:
            raise InputError(path, row=row, value=quote(cell), allowed="a finite number")
    return values


def _camera(path: Path, row: int, model: str, values: list[float]) -> Camera:
    if model not in _PINHOLES:
        hint = "PINHOLE or SIMPLE_PINHOLE: undistort the images first (colmap image_undistorter)"
        raise InputError(path, row=row, value=f"camera model {quote(model)}", allowed=hint)
    width, height, *parameters = values
    if len(parameters) != _PINHOLES[model]:
        allowed = f"{_PINHOLES[model]} parameters for {model}"
        raise InputError(path, row=row, value=f"{len(parameters)} parameters", allowed=allowed)
    focal, centre = parameters[:-2], parameters[-2:]
    bounds = [("width", width, 1.0, 16384.0), ("height", height, 1.0, 16384.0)]
    bounds += [("focal length", value, 1e-3, _FARTHEST) for value in focal]
    bounds += [("principal point", value, -1e6, 1e6) for value in centre]
    for name, value, low, high in bounds:
        if not low <= value <= high or (low == 1.0 and value != int(value)):
            raise InputError(path, row=row, value=f"{name} {value:g} px", allowed="a camera of 1 to 16384 px")
    return Camera(int(width), int(height), torch.tensor([focal[0], focal[-1], *centre], dtype=torch.float64))


def _image(path: Path, row: int, name: str, camera: int, pose: list[float], cameras: dict[int, Camera]) -> PosedImage:
    """Return an image from the number of its camera and q, t of X_CS."""
    if camera not in cameras:
        raise InputError(path, row=row, value=f"camera {camera}", allowed="a camera of the model")
    if not name or not name.isprintable():
        raise InputError(path, row=row, value=f"image {name!a}", allowed="the name of an image file")
    values = np.array(pose, float)
    finite = bool((np.abs(values) <= _FARTHEST).all())  # false for NaN too
    norm = float(np.linalg.norm(values[:4])) if finite else np.nan
    if not abs(norm - 1) <= _UNIT_NORM:
        found = f"pose {np.round(values, 6).tolist()}"
        raise InputError(path, row=row, value=found, allowed="QW QX QY QZ of norm 1, and finite TX TY TZ")
    X_CS = Pose(torch.from_numpy(values[:4] / norm), torch.from_numpy(values[4:]))
    return PosedImage(Path(name), None, cameras[camera], inverse(X_CS))
