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

from pinwm_drake.capture.episodes import CAMERA_FILE, START_FILE, View, read_episode
from pinwm_drake.capture.images import read_mask, read_photo, require_size
from pinwm_drake.capture.paths import require_file
from pinwm_drake.capture.pusher import pusher_surface
from pinwm_drake.capture.scene import (
    CAPTURE_FILE,
    EPISODES,
    Capture,
    PusherGeometry,
    UnfinishedCapture,
    load_capture,
    load_unfinished,
)
from pinwm_drake.capture.static_views import TRANSFORMS, find_mask, is_picture, mask_place
from pinwm_drake.capture.transforms import read_transforms
from pinwm_drake.documents import read_json
from pinwm_drake.errors import InputError, ParameterError
from pinwm_drake.experiments.progress import Progress, silent
from pinwm_drake.files import prepare_folder, replacing
from pinwm_drake.geometry.hull.surface import hull_meshes
from pinwm_drake.geometry.meshes import load_mesh
from pinwm_drake.masks.moving import follow
from pinwm_drake.masks.segmenter import OnnxSegmenter
from pinwm_drake.masks.shots import Shot
from pinwm_drake.masks.static import FEWEST, Found, find_masks
from pinwm_drake.reading.contents import read_bytes
from pinwm_drake.spatial.rigid import from_pose, inverse

RECORD = "made.json"  # in a folder `masks`: SHA-256 of each mask that a program made


@dataclass(frozen=True, eq=False)
class Masked:
    """Masks of images.

    Attributes:
        written: Number of masks that were written.
        kept: Number of hand-made masks, or of images with alpha.
        doubts: Path of an image or folder, and the reason to doubt its mask.
        static: Those of the static views; None where they were not looked for.
    """

    written: int
    kept: int
    doubts: list[tuple[str, str]]
    static: Found | None = None

    def words(self) -> list[str]:
        """What was done, and the doubts, which begin with "doubtful: "; one line each."""
        kept = f", kept {self.kept} that others made" if self.kept else ""
        doubts = [f"doubtful: {name}: {reason}" for name, reason in self.doubts]
        return [f"wrote {self.written} masks{kept}; {len(doubts)} doubts", *doubts]


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
        InputError: A file is missing or refused, or there are too few static views.
        ParameterError: There are a size and a mesh.
    """
    capture, mesh = load_unfinished(folder), None
    if capture.mesh_path is not None and use_mesh:
        allowed = f"the mesh that {CAPTURE_FILE} names; pinwm mesh makes one, --no-mesh does without"
        mesh = load_mesh(require_file(capture.mesh_path, allowed))
    if mesh is not None and size is not None:
        raise ParameterError(f"--size: got {size:g} and a mesh; allowed: one of the two; --no-mesh leaves the mesh out")
    network = OnnxSegmenter(segmenter) if segmenter else None
    static = folder / "static"
    progress("static views", 0.0, "reading")
    shots, masks, made = read_shots(static)
    known = {k: mask for k, mask in masks.items() if k not in made}
    if len(shots) < FEWEST:
        raise InputError(static / TRANSFORMS, value=f"{len(shots)} views", allowed=f"{FEWEST} or more")
    guess = None if capture.X_WO is None else from_pose(capture.X_WO)
    found = find_masks(shots, capture.floor_height, known=known, mesh=mesh, guess=guess, size=size, segmenter=network)
    paths = [static / shot.name for shot in shots]
    progress("static views", 1.0, f"{len(shots)} masks")
    _Record(static).write(
        [(path, mask) for k, (path, mask) in enumerate(zip(paths, found.masks, strict=True)) if k not in known]
    )
    written, kept = len(shots) - len(known), len(known)
    doubts = [(f"static/{name}" if name else "static", reason) for name, reason in found.doubts]
    if pushes and capture.episode_names and capture.pusher == PusherGeometry(None, None):
        doubts.append(("episodes", "no pusher in capture.yaml: images of pushes get no masks"))
    elif pushes and capture.episode_names:
        model = _model(capture, mesh, shots, found)
        for number, name in enumerate(capture.episode_names):
            more = _mask_episode(capture, name, model)
            progress("pushes", (number + 1) / len(capture.episode_names), name)
            written, kept, doubts = written + more.written, kept + more.kept, doubts + more.doubts
    return Masked(written, kept, doubts, found)


def mask_push(folder: Path, name: str) -> Masked:
    """Write the masks of a push, which the mesh of the capture follows from the pose at the start.

    Args:
        folder: The capture.
        name: Name of the push.

    Raises:
        InputError: A file is missing or refused.
    """
    capture = load_capture(folder)
    X_WO = from_pose(capture.object.X_WO)
    return _mask_episode(capture, name, _Model(load_mesh(capture.object.mesh_path), X_WO, X_WO))


def read_shots(static: Path) -> tuple[list[Shot], dict[int, np.ndarray], set[int]]:
    """Photos of a folder with `transforms.json`, with their masks (H, W) bool by number.

    Returns:
        The photos, the masks of those that have any, and the numbers of those masks that `pinwm mask` made.

    Raises:
        InputError: A file is missing or refused, or of another size than its camera; see `read_views`.
    """
    shots, masks, made, record = list[Shot](), dict[int, np.ndarray](), set[int](), _Record(static)
    for k, frame in enumerate(read_transforms(static / TRANSFORMS)):
        image, alpha = read_photo(frame.image_path)
        require_size(frame.image_path, image[..., 0], frame.camera, f"as {frame.entry.path} says ({frame.entry.place})")
        shots.append(Shot.of(frame.file_path, image, frame.camera, frame.X_WC))
        path = frame.mask_path or find_mask(static, frame.image_path, required=False)
        own = path is not None and record.has(path)
        if path is not None and (alpha is None or not own):
            masks[k] = read_mask(path)
            require_size(path, masks[k], frame.camera, f"the size of {frame.file_path}")
        elif alpha is not None:
            masks[k] = alpha
        if own and alpha is None:
            made.add(k)
    return shots, masks, made


def hand_made_masks(folder: Path) -> list[Path]:
    """Pictures in the folder `masks` that `pinwm mask` has not made."""
    record = _Record(folder)
    return [path for path in sorted((folder / "masks").rglob("*")) if is_picture(path) and not record.has(path)]


@dataclass(frozen=True, eq=False)
class _Model:
    """Mesh that follows the object in pushes.

    Attributes:
        mesh: m, frame M: the object's, or that of the world for a hull.
        X_WM: (4, 4) m, where it is in the static views.
        X_WO: (4, 4) m, where the object is in them; None where nothing tells it.
    """

    mesh: trimesh.Trimesh
    X_WM: np.ndarray
    X_WO: np.ndarray | None


def _model(capture: UnfinishedCapture, mesh: trimesh.Trimesh | None, shots: Sequence[Shot], found: Found) -> _Model:
    """The capture's mesh, or the hull of the static masks."""
    if mesh is not None and found.pose is not None:
        return _Model(mesh, found.pose.X_WO, found.pose.X_WO)
    hulls = hull_meshes(found.masks, [shot.P for shot in shots], found.hull, found.voxel, capture.floor_height)
    if not hulls:
        raise InputError(capture.folder / "static", value="no thing in the static masks", allowed="masks of the object")
    return _Model(hulls[0], np.eye(4), None if capture.X_WO is None else from_pose(capture.X_WO))


def _mask_episode(capture: Capture | UnfinishedCapture, name: str, model: _Model) -> Masked:
    """Write the masks of a push."""
    episode, place = read_episode(capture, name), f"{EPISODES}/{name}"
    if not episode.file_names:
        return Masked(0, 0, [(place, "no film, and so no masks")])
    X_WM, doubts = model.X_WM, list[tuple[str, str]]()
    if episode.start is not None:
        if model.X_WO is None:
            return Masked(0, 0, [(place, f"{START_FILE} needs a mesh, or object.X_WO in {CAPTURE_FILE}: no masks")])
        X_WM = from_pose(episode.start) @ inverse(model.X_WO) @ model.X_WM
    if episode.start_velocity is not None:
        doubts.append((place, f"thrown, as {START_FILE} says: masks follow things that slide"))
    pusher, written, kept = pusher_surface(capture.pusher, sections=24), 0, 0
    for view in episode.views:
        poses = [from_pose(episode.pusher_pose(float(t))) for t in view.t]
        record, new = _Record(view.folder), []
        readers = [_Reader(view, k) for k in range(len(view.t))]
        for reader, (mask, _, doubt) in zip(readers, follow(readers, model.mesh, X_WM, pusher, poses), strict=True):
            there = find_mask(view.folder, reader.path, required=False)
            if reader.cut_out or (there is not None and not record.has(there)):
                kept += 1
                continue
            new.append((reader.path, mask))
            if doubt:
                doubts.append((str(reader.path.relative_to(capture.folder)), doubt))
        record.write(new)
        written += len(new)
    return Masked(written, kept, doubts)


class _Reader:
    """Reader of one image of a push."""

    def __init__(self, view: View, k: int) -> None:
        self._view, self.path = view, view.folder / view.file_names[k]
        self.cut_out = False  # it has alpha, as far as it was read

    def __call__(self) -> Shot:
        image, alpha = read_photo(self.path)
        self.cut_out = alpha is not None
        require_size(self.path, image[..., 0], self._view.camera, f"as {self._view.folder / CAMERA_FILE} says")
        return Shot.of(self.path.name, image, self._view.camera, self._view.X_WC)


class _Record:
    """Masks of the images below a folder, of which it knows those that `pinwm mask` made."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._record = folder / "masks" / RECORD
        self._made = read_made(self._record)

    def has(self, path: Path) -> bool:
        """Flag: a mask is as `pinwm mask` made it."""
        made = self._made.get(self._name(path))
        return made is not None and made == sha256_of(path)

    def write(self, masks: Sequence[tuple[Path, np.ndarray]]) -> None:
        """Write masks (H, W) bool of images, and the record of them."""
        for image_path, mask in masks:
            path = mask_place(self._folder, image_path)
            prepare_folder(path.parent)
            content = cv2.imencode(".png", 255 * mask.astype(np.uint8))[1].tobytes()
            with replacing(path) as temporary:
                temporary.write_bytes(content)
            self._made[self._name(path)] = hashlib.sha256(content).hexdigest()
        if masks:
            write_made(self._record, self._made)

    def _name(self, path: Path) -> str:
        masks = self._folder / "masks"
        return (path.relative_to(masks) if path.is_relative_to(masks) else path).as_posix()


def read_made(path: Path) -> dict[str, str]:
    """SHA-256 of files by their names, as a program recorded them; none without a record.

    Raises:
        InputError: The file is no record.
    """
    if not path.is_file():
        return {}
    entry = read_json(path)
    if not isinstance(entry.value, dict):
        raise entry.refusal("SHA-256 by the names of files; without this record all of them count as a person's")
    return {key: entry[key].text() for key in entry.value}


def write_made(path: Path, made: dict[str, str]) -> None:
    """Write a record that `read_made` reads."""
    with replacing(path) as temporary:
        temporary.write_text(json.dumps(made, indent=1) + "\n", encoding="utf-8")


def sha256_of(path: Path) -> str:
    """SHA-256 of the contents of a file."""
    return hashlib.sha256(read_bytes(path)).hexdigest()
