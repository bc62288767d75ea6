# SPDX-License-Identifier: MIT
"""Pictures of the stages of a lab: photos with the outlines of masks and mesh, residuals, films, and what was made."""

from collections.abc import Sequence
from pathlib import Path
from typing import TypeVar

import cv2
import numpy as np
import trimesh

from pinwm_drake.capture.episodes import read_episode
from pinwm_drake.capture.images import read_mask, read_photo, read_pixels
from pinwm_drake.capture.scene import load_capture, load_unfinished
from pinwm_drake.capture.static_views import find_mask
from pinwm_drake.capture.transforms import read_transforms
from pinwm_drake.geometry.meshes import load_mesh
from pinwm_drake.guide.lab import LabFolder
from pinwm_drake.rendering.camera import Camera
from pinwm_drake.rendering.silhouette import silhouette
from pinwm_drake.report.style import evenly
from pinwm_drake.report.surfels.fit_results import FIGURE_FILE
from pinwm_drake.spatial.poses import Pose, compose, inverse
from pinwm_drake.station.calibrate import PICTURES
from pinwm_drake.station.lab import SETS

Picture = tuple[np.ndarray, str]
"""(height, width, 3) uint8, sRGB, and its caption."""
_T = TypeVar("_T")
_Layer = tuple[np.ndarray, tuple[int, int, int]]
_WIDE, _MOST = 420, 6  # px of a picture, and pictures of a stage
_MASK, _MESH = (60, 220, 60), (240, 70, 50)


def pictures_of(lab: LabFolder, key: str) -> list[Picture]:
    """Pictures of a stage that is done; none for stages without any.

    Args:
        lab: The lab.
        key: Key of the stage.

    Raises:
        PinwmError: A file cannot be read.
    """
    if key == "calibration":
        folders = (lab.station.parent / PICTURES / name for name in SETS)
        chosen = [path for folder in folders for path in _some(sorted(folder.glob("*.png")), 2)]
        return [(_small(read_pixels(path)[..., :3]), f"{path.parent.name}/{path.name}") for path in chosen]
    if key in ("photos", "masks", "mesh", "pose"):
        return _views(lab, outlines=key != "photos", meshes=key in ("mesh", "pose"))
    if key.startswith("push "):
        return _push(lab, key.removeprefix("push "))
    pushes = {"first": lab.first / "next_push.png", "next": lab.next / "next_push.png"}
    made = {"appearance": lab.twin / FIGURE_FILE} | pushes
    path = made.get(key)
    if path is None or not path.is_file():
        return []
    return [(np.ascontiguousarray(read_pixels(path)[..., :3]), path.name)]


def _views(lab: LabFolder, *, outlines: bool, meshes: bool) -> list[Picture]:
    """Some of the static views, with the outlines of masks and of the mesh at its pose."""
    capture, found = load_unfinished(lab.capture), []
    mesh = load_mesh(capture.mesh_path) if meshes and capture.mesh_path and capture.X_WO is not None else None
    for frame in _some(read_transforms(lab.transforms), _MOST):
        image, alpha = read_photo(frame.image_path)
        mask_path = frame.mask_path or find_mask(lab.static, frame.image_path, required=False)
        mask = alpha if mask_path is None else read_mask(mask_path)
        layers = [(mask, _MASK)] if outlines and mask is not None else []
        if mesh is not None and capture.X_WO is not None:
            X_CO = compose(inverse(frame.X_WC), capture.X_WO)
            layers += _mesh_layer(mesh, frame.camera, X_CO)
        found.append((_drawn(image, layers), Path(frame.file_path).name))
    return found


def _push(lab: LabFolder, name: str) -> list[Picture]:
    """Some images of a push, with the outlines of their masks."""
    episode, found = read_episode(load_capture(lab.capture), name), []
    for k in _some(range(len(episode.t)), _MOST):
        path = episode.folder / episode.file_names[k]
        image, alpha = read_photo(path)
        mask_path = find_mask(episode.folder, path, required=False)
        mask = alpha if mask_path is None else read_mask(mask_path)
        found.append((_drawn(image, [] if mask is None else [(mask, _MASK)]), f"{episode.t[k]:.2f} s"))
    return found


def _mesh_layer(mesh: trimesh.Trimesh, camera: Camera, X_CO: Pose) -> list[_Layer]:
    mask = silhouette(mesh, camera, X_CO)
    return [] if mask is None else [(mask, _MESH)]


def _drawn(image: np.ndarray, layers: Sequence[_Layer]) -> np.ndarray:
    """Small image with the outlines of masks (H, W) bool."""
    small = _small(image)
    for mask, colour in layers:
        shrunk = cv2.resize(mask.astype(np.uint8), small.shape[1::-1], interpolation=cv2.INTER_AREA)
        lines, _ = cv2.findContours(shrunk, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        cv2.drawContours(small, lines, -1, colour, 1, cv2.LINE_AA)
    return small


def _small(image: np.ndarray) -> np.ndarray:
    """Copy of an image of the width of those of a page, or as it is where it is smaller."""
    image = np.ascontiguousarray(image)
    height, width = image.shape[:2]
    if width <= _WIDE:
        return image.copy()
    return cv2.resize(image, (_WIDE, round(height * _WIDE / width)), interpolation=cv2.INTER_AREA)


def _some(items: Sequence[_T], number: int) -> list[_T]:
    return [items[k] for k in evenly(len(items), number)]
