# SPDX-License-Identifier: MIT
"""Import of COLMAP's sparse models, text or binary, with their images.

COLMAP gives the world in the camera's axes (x right, y down, z forward), X_CS; it becomes X_SC here. Its pixel
(0, 0) covers the square from 0 to 1, as ours does.

pycolmap 4.2 was tried in place of this reader. It needs `points3D` too, names neither file nor line of an error, reads
some truncated and damaged files without one, and takes 135 MB.
"""

import math
import re
import struct
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from pinwm_drake.capture.episode_tables import quote
from pinwm_drake.capture.importers.lenses import COLMAP_MODELS, COLMAP_OBEYED, colmap_camera
from pinwm_drake.capture.importers.similarity import Similarity
from pinwm_drake.capture.importers.target import (
    PosedImage,
    Report,
    Scenery,
    tell_unposed,
    unheard,
    write_scenery,
    write_static,
)
from pinwm_drake.capture.lens import Lens
from pinwm_drake.capture.paths import is_file, is_folder, require_file
from pinwm_drake.capture.static_views import is_picture, named_mask
from pinwm_drake.errors import InputError
from pinwm_drake.files import appearing
from pinwm_drake.reading.contents import read_bytes, read_text
from pinwm_drake.rendering.camera import Camera
from pinwm_drake.spatial.poses import Pose, identity, inverse

_MODEL_FOLDERS = ("", "sparse/0", "sparse", "0")
_MODEL_FILES = ("images.bin", "images.txt")
_ANNOUNCED = re.compile(r"Number of images:\s*(\d{1,9})\b", re.ASCII)
_WHOLE = re.compile(r"[-+]?\d{1,19}", re.ASCII)
_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?", re.ASCII)
_UNIT_NORM = 1e-3
_Cameras = dict[int, tuple[Camera, Lens | None]]  # by their numbers
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
        masks: Folder of the masks, as `NAME.png` for an image `NAME`, or with its name up to the suffix; None for
            `masks` beside the folder of the images, or where that is not there, for alpha or a white background.
        report: Called with the share of the images that are written.

    Raises:
        InputError: The model, an image or a mesh is refused; see `read_model` and `read_image`.
    """
    model = _model_folder(source)
    folder = images or _image_folder(source, model)
    beside = folder.parent / "masks"
    if masks is None and is_folder(beside) and any(map(is_picture, beside.rglob("*"))):
        masks = beside
    posed = [_posed(image, folder, masks) for image in read_model(model)]
    _require_different(posed)
    tell_unposed(folder.parent, [image.path for image in posed])
    _tell_others(model)
    with appearing(out) as capture:
        X_WO = scenery.X_WO or identity()
        write_scenery(capture, scenery, X_WO)
        write_static(capture, posed, similarity, scenery.mesh, X_WO, report)
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
    path = require_file(images / image.path, "the image that the model names")
    if masks is None:
        return replace(image, path=path)
    if not is_folder(masks):
        raise InputError(masks, value="no such folder", allowed="a folder of masks")
    mask = named_mask(masks, path, image.path.parent, images)
    if mask is None:
        raise InputError(masks / f"{image.path}.png", value="no such file", allowed=f"the mask of {image.path}")
    return replace(image, path=path, mask_path=mask)


def _require_different(images: list[PosedImage]) -> None:
    seen: dict[Path, Path] = {}
    for image in images:
        other = seen.setdefault(image.path.resolve(), image.path)
        if other is not image.path:
            raise InputError(image.path, value=f"the same file as {other}", allowed="each image once")


def _tell_others(model: Path) -> None:
    """Warns of further models, in which COLMAP puts images that it could not join to the first one."""
    if model.name.isdecimal():
        others = sorted(path.name for path in model.parent.iterdir() if path.name.isdecimal() and path != model)
        if others:
            found = f"{model.parent}: {model.name} is imported, {', '.join(others)} left out"
            warnings.warn(found, UserWarning, stacklevel=2)


def read_model(folder: Path) -> list[PosedImage]:
    """Images of a COLMAP model in the order of their paths, which count from the folder of the images; no masks.

    Args:
        folder: Folder with `cameras.bin` and `images.bin`, or else `cameras.txt` and `images.txt`.

    Raises:
        InputError: A file is missing, truncated or wrong, or the model of a camera is not obeyed.
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


def _read_text_cameras(path: Path) -> _Cameras:
    cameras: _Cameras = {}
    for row, line in enumerate(read_text(path).splitlines(), start=1):
        cells = line.split()
        if not cells or cells[0].startswith("#"):
            continue
        values = _numbers(path, row, cells[:1] + cells[2:])
        if len(cells) < 4:
            raise InputError(path, row=row, value=quote(line), allowed="CAMERA_ID MODEL WIDTH HEIGHT PARAMS[]")
        number = _whole(path, row, cells[0])
        _require_new(path, row, f"camera {number}", number in cameras)
        cameras[number] = colmap_camera(path, row, cells[1], values[1:])
    return cameras


def _read_text_images(path: Path, cameras: _Cameras) -> list[PosedImage]:
    records, announced = _Records(path), None
    expected = "IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME, then a line of points"
    lines = iter(enumerate(read_text(path).splitlines(), start=1))
    for row, line in lines:
        if line.lstrip().startswith("#"):
            count = _ANNOUNCED.search(line)
            announced = announced if count is None else (row, int(count[1]))
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        cells = line.split(maxsplit=9)
        if len(cells) < 10:
            raise InputError(path, row=row, value=quote(line), allowed=expected)
        values = _numbers(path, row, cells[:9])
        name = cells[9].strip()
        number, camera = _whole(path, row, cells[0]), _whole(path, row, cells[8])
        records.add(row, number, _image(path, row, name, camera, values[1:8], cameras))
        points = next((pair for pair in lines if not pair[1].lstrip().startswith("#")), None)
        if points is not None and not _are_points(points[1].split()):
            allowed = f"the points of {name} (X Y POINT3D_ID ...), or an empty line where it has none"
            raise InputError(path, row=points[0], value=quote(points[1]), allowed=allowed)
    if announced is not None and announced[1] != len(records.images):
        found = f"{path}, row {announced[0]}: {announced[1]} images announced, {len(records.images)} found"
        warnings.warn(found, UserWarning, stacklevel=2)
    return records.images


def _are_points(cells: list[str]) -> bool:
    """Flag: cells are the points of an image, X Y POINT3D_ID each, or none."""
    return len(cells) % 3 == 0 and all(
        _NUMBER.fullmatch(cell) and (k % 3 < 2 or _WHOLE.fullmatch(cell)) for k, cell in enumerate(cells)
    )


class _Records:
    """Images of a model so far, each with a number and a name of its own."""

    def __init__(self, path: Path) -> None:
        self.path, self.images = path, list[PosedImage]()
        self._numbers: set[int] = set()
        self._names: set[Path] = set()

    def add(self, row: int, number: int, image: PosedImage) -> None:
        """Add an image; raise InputError where its number or name is there already."""
        _require_new(self.path, row, f"image {number}", number in self._numbers)
        _require_new(self.path, row, f"image {quote(str(image.path))}", image.path in self._names)
        self._numbers.add(number)
        self._names.add(image.path)
        self.images.append(image)


def _require_new(path: Path, row: int, name: str, known: bool) -> None:
    if known:
        raise InputError(path, row=row, value=f"{name} again", allowed=f"each {name.split()[0]} once")


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

    def end(self, records: int) -> None:
        """Require the file to end here, after a number of records; raise InputError otherwise."""
        left = len(self.data) - self.at
        if left:
            found = f"{left} more bytes after the {records} records that the file announces"
            raise InputError(self.path, value=found, allowed="as many records as it announces")

    def count(self, row: int | None = None) -> int:
        """Return the number of the records that follow; no more than there are bytes."""
        return min(int(self.take("Q", row)[0]), len(self.data) + 1)


def _read_binary_cameras(path: Path) -> _Cameras:
    data, cameras = _Binary(path), {}
    for row in range(1, data.count() + 1):
        number, model, width, height = data.take("iiQQ", row)
        if not 0 <= model < len(COLMAP_MODELS):
            raise InputError(path, row=row, value=f"camera model {model}", allowed=COLMAP_OBEYED)
        name, count, _ = COLMAP_MODELS[model]
        _require_new(path, row, f"camera {number}", number in cameras)
        cameras[number] = colmap_camera(path, row, name, [width, height, *data.take(f"{count}d", row)])
    data.end(len(cameras))
    return cameras


def _read_binary_images(path: Path, cameras: _Cameras) -> list[PosedImage]:
    data, records = _Binary(path), _Records(path)
    for row in range(1, data.count() + 1):
        number, *values, camera = data.take("i7di", row)
        end = data.data.find(b"\0", data.at)
        length = (len(data.data) if end < 0 else end) - data.at
        name = data.take(f"{length}sx", row)[0].decode("utf-8", errors="backslashreplace")
        data.take(f"{24 * data.count(row)}x", row)  # its points
        records.add(row, number, _image(path, row, name, camera, values, cameras))
    data.end(len(records.images))
    return records.images


def _whole(path: Path, row: int, cell: str) -> int:
    if not _WHOLE.fullmatch(cell):
        raise InputError(path, row=row, value=quote(cell), allowed="a whole number")
    return int(cell)


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


def _image(path: Path, row: int, name: str, camera: int, pose: list[float], cameras: _Cameras) -> PosedImage:
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
    return PosedImage(Path(name), None, cameras[camera][0], inverse(X_CS), cameras[camera][1])
