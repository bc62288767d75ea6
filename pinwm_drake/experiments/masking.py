# SPDX-License-Identifier: MIT
"""Masks of all images of a capture: static views first, then the pushes; hand-made ones stay as they are."""

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import trimesh

from pinwm_drake.capture.episodes import View, read_episode
from pinwm_drake.capture.images import read_mask, read_photo, require_size
from pinwm_drake.capture.pusher import pusher_surface
from pinwm_drake.capture.scene import Capture, PusherGeometry, UnfinishedCapture, load_capture, load_unfinished
from pinwm_drake.capture.static_views import TRANSFORMS, mask_place, masks_beside
from pinwm_drake.capture.transforms import read_transforms
from pinwm_drake.documents import read_json
from pinwm_drake.errors import InputError
from pinwm_drake.experiments.progress import Progress, silent
from pinwm_drake.files import prepare_folder, replacing
from pinwm_drake.geometry.hull.surface import hull_mesh
from pinwm_drake.geometry.meshes import load_mesh
from pinwm_drake.masks.moving import follow
from pinwm_drake.masks.segmenter import OnnxSegmenter
from pinwm_drake.masks.shots import Shot
from pinwm_drake.masks.static import FEWEST, Found, find_masks
from pinwm_drake.reading.contents import read_bytes
from pinwm_drake.spatial.poses import pose_to_matrix

RECORD = "made.json"  # in a folder `masks`: SHA-256 of each mask that a program made


@dataclass(frozen=True, eq=False)
class Masked:
    """Masks of a capture.

    Attributes:
        static: Those of the static views.
        written: Number of masks that were written.
        kept: Number of hand-made masks, or of images with alpha.
        doubts: Path of an image, or "" for all of a kind, and the reason to doubt its mask.
    """

    static: Found
    written: int
    kept: int
    doubts: list[tuple[str, str]]


def mask_capture(
    folder: Path,
    *,
    size: float | None = None,
    segmenter: Sequence[Path] = (),
    use_mesh: bool = True,
    pushes: bool = True,
    progress: Progress = silent,
) -> Masked:
    """Write masks of all images of a capture.

    Args:
        folder: The capture. It may have no mesh, and no `capture.yaml`.
        size: Largest extent of the object, m; None for what mesh or cameras tell.
        segmenter: ONNX files of a network that cuts out objects; see `OnnxSegmenter`.
        use_mesh: Flag: the mesh is used, if there is one.
        pushes: Flag: images of pushes get masks too.
        progress: Called with the stages "static views" and "pushes".

    Raises:
        InputError: A file is refused, or there are too few static views.
    """
    capture = load_unfinished(folder)
    mesh = load_mesh(capture.mesh_path) if capture.mesh_path is not None and use_mesh else None
    network = OnnxSegmenter(segmenter) if segmenter else None
    static = folder / "static"
    progress("static views", 0.0, "reading")
    shots, known = read_shots(static)
    if len(shots) < FEWEST:
        raise InputError(static / TRANSFORMS, value=f"{len(shots)} views", allowed=f"{FEWEST} or more")
    guess = None if capture.X_WO is None else pose_to_matrix(capture.X_WO).numpy()
    found = find_masks(shots, capture.floor_height, known=known, mesh=mesh, guess=guess, size=size, segmenter=network)
    paths = [static / shot.name for shot in shots]
    progress("static views", 1.0, f"{len(shots)} masks")
    writer = _Writer(static)
    writer.write(
        [(path, mask) for k, (path, mask) in enumerate(zip(paths, found.masks, strict=True)) if k not in known]
    )
    written, kept = len(shots) - len(known), len(known)
    doubts = [(f"static/{name}" if name else "static", reason) for name, reason in found.doubts]
    if pushes and capture.episode_names and capture.pusher == PusherGeometry(None, None):
        doubts.append(("episodes", "no pusher in capture.yaml: images of pushes get no masks"))
    elif pushes and capture.episode_names:
        model, X_WO = _model(capture, mesh, shots, found)
        for number, name in enumerate(capture.episode_names):
            more = _mask_episode(capture, name, model, X_WO)
            progress("pushes", (number + 1) / len(capture.episode_names), name)
            written, kept, doubts = written + more[0], kept + more[1], doubts + more[2]
    return Masked(found, written, kept, doubts)


def mask_push(folder: Path, name: str) -> tuple[int, int, list[tuple[str, str]]]:
    """Write the masks of a push, which the mesh of the capture follows from the pose at the start.

    Args:
        folder: The capture.
        name: Name of the push.

    Returns:
        Numbers of masks that were written and kept, and doubts as in `Masked`.

    Raises:
        InputError: A file is missing or refused.
    """
    capture = load_capture(folder)
    mesh, X_WO = load_mesh(capture.object.mesh_path), pose_to_matrix(capture.object.X_WO).numpy()
    return _mask_episode(capture, name, mesh, X_WO)


def read_shots(static: Path) -> tuple[list[Shot], dict[int, np.ndarray]]:
    """Photos of a folder with `transforms.json`, and their hand-made masks (H, W) bool by number.

    Raises:
        InputError: A file is missing or refused; see `read_views`.
    """
    shots, known, writer = [], {}, _Writer(static)
    for k, frame in enumerate(read_transforms(static / TRANSFORMS)):
        image, mask = read_photo(frame.image_path)
        require_size(frame.image_path, image[..., 0], frame.camera, f"as {frame.entry.path} says ({frame.entry.place})")
        made = read_mask(frame.mask_path) if frame.mask_path is not None else writer.hand_made(frame.image_path)
        mask = mask if made is None else made
        if mask is not None:
            require_size(frame.image_path, mask, frame.camera, "as its mask")
            known[k] = mask
        shots.append(Shot.of(frame.file_path, image, frame.camera, frame.X_WC))
    return shots, known


def written_masks(static: Path, shots: Sequence[Shot]) -> dict[int, np.ndarray]:
    """Masks (H, W) bool in the folder `masks`, whoever made them, by the number of the shot."""
    found = {k: masks_beside(static, static / shot.name) for k, shot in enumerate(shots)}
    return {k: read_mask(paths[0]) for k, paths in found.items() if len(paths) == 1}


def _model(
    capture: UnfinishedCapture, mesh: trimesh.Trimesh | None, shots: Sequence[Shot], found: Found
) -> tuple[trimesh.Trimesh, np.ndarray]:
    """Mesh that follows the object, and its pose (4, 4): the capture's, or the hull of the static masks."""
    if mesh is not None and found.pose is not None:
        return mesh, found.pose.X_WO
    hull = hull_mesh(found.masks, [shot.P for shot in shots], found.hull, found.voxel, capture.floor_height)
    if hull is None:
        raise InputError(capture.folder / "static", value="no thing in the static masks", allowed="masks of the object")
    return hull, np.eye(4)


def _mask_episode(
    capture: Capture | UnfinishedCapture, name: str, mesh: trimesh.Trimesh, X_WO: np.ndarray
) -> tuple[int, int, list[tuple[str, str]]]:
    """Write the masks of a push; returns the numbers that were written and kept, and doubts."""
    episode, pusher = read_episode(capture, name), pusher_surface(capture.pusher, sections=24)
    written, kept, doubts = 0, 0, []
    for view in episode.views:
        poses = [pose_to_matrix(episode.pusher_pose(float(t))).numpy() for t in view.t]
        writer, new = _Writer(view.folder), []
        steps = follow([_Reader(view, k) for k in range(len(view.t))], mesh, X_WO, pusher, poses)
        for file_name, (mask, _, doubt) in zip(view.file_names, steps, strict=True):
            path = view.folder / file_name
            if writer.hand_made(path) is not None or read_photo(path)[1] is not None:
                kept += 1
                continue
            new.append((path, mask))
            if doubt:
                doubts.append((str(path.relative_to(capture.folder)), doubt))
        writer.write(new)
        written += len(new)
    return written, kept, doubts


@dataclass(frozen=True, eq=False)
class _Reader:
    """Reader of one image of a push."""

    view: View
    k: int

    def __call__(self) -> Shot:
        path = self.view.folder / self.view.file_names[self.k]
        image, _ = read_photo(path)
        require_size(path, image[..., 0], self.view.camera, f"as {self.view.folder / 'camera.json'} says")
        return Shot.of(path.name, image, self.view.camera, self.view.X_WC)


class _Writer:
    """Masks of the images below a folder, of which it knows those that it wrote itself."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._record = folder / "masks" / RECORD
        self._made: dict[str, str] = {}
        if self._record.is_file():
            entry = read_json(self._record)
            self._made = {key: entry[key].text() for key in entry.value} if isinstance(entry.value, dict) else {}

    def hand_made(self, image_path: Path) -> np.ndarray | None:
        """Mask (H, W) bool of an image that nobody but a person made, or another program; None without one."""
        found = masks_beside(self._folder, image_path)
        if len(found) > 1:
            raise InputError(found[0], value=f"{found[1].name} beside it", allowed=f"one mask of {image_path.name}")
        if not found or self._made.get(self._name(found[0])) == _hash(read_bytes(found[0])):
            return None
        return read_mask(found[0])

    def write(self, masks: Sequence[tuple[Path, np.ndarray]]) -> None:
        """Write masks (H, W) bool of images, and the record of them."""
        for image_path, mask in masks:
            path = mask_place(self._folder, image_path)
            prepare_folder(path.parent)
            content = cv2.imencode(".png", 255 * mask.astype(np.uint8))[1].tobytes()
            with replacing(path) as temporary:
                temporary.write_bytes(content)
            self._made[self._name(path)] = _hash(content)
        if masks:
            with replacing(self._record) as temporary:
                temporary.write_text(json.dumps(self._made, indent=1) + "\n", encoding="utf-8")

    def _name(self, path: Path) -> str:
        return path.relative_to(self._folder / "masks").as_posix()


def _hash(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()
