# SPDX-License-Identifier: MIT
"""Checks of the static views: each by itself, and how they surround the object."""

from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import torch
import trimesh

from pinwm_drake.capture.checks.findings import Findings
from pinwm_drake.capture.checks.pictures import check_area, check_camera, check_sharpness, compare, sharpness
from pinwm_drake.capture.checks.scene import Scene
from pinwm_drake.capture.refusals import attempt
from pinwm_drake.capture.static_views import TRANSFORMS, read_frame_image, require_outside, require_seen
from pinwm_drake.capture.transforms import Frame, read_frame, require_different, require_known
from pinwm_drake.capture.units import Seen, scale_doubts, seen_size
from pinwm_drake.documents import Entry, read_json
from pinwm_drake.errors import InputError
from pinwm_drake.rendering.camera import Camera
from pinwm_drake.rendering.silhouette import silhouette
from pinwm_drake.rendering.views import project
from pinwm_drake.spatial.poses import Pose, compose, inverse
from pinwm_drake.spatial.rotations import quaternion_to_matrix

_FEWEST_VIEWS = 8
_WIDEST_GAP = 120.0  # deg of azimuth between neighbouring cameras
_UNSEEN = 0.05  # share of the surface, without what faces the floor, that no camera looks at
_DOWN = -0.7  # z of normals that face the floor


def check_static(scene: Scene, findings: Findings, progress: Callable[[str], None]) -> int:
    """Check the static views in `static/` and return their number; `progress` is told what comes next."""
    path = scene.folder / "static" / TRANSFORMS
    document = attempt(lambda: read_json(path), findings.error)
    entries = None if document is None else attempt(lambda: document["frames"].items(), findings.error)
    if document is None or entries is None:
        return 0
    attempt(lambda: require_known(document), findings.error)
    read = (attempt(partial(read_frame, document, entry), findings.error) for entry in entries)
    frames = [frame for frame in read if frame is not None]
    require_different(frames, findings.error)
    sharp: list[tuple[Path, float | None]] = []
    seen: list[Seen] = []
    for frame in frames:
        progress(f"static/{frame.file_path}")
        check_camera(path, frame.camera, findings)
        _check_view(frame, scene, findings, sharp, seen)
    if scene.mesh is not None and scene.X_WO is not None:
        findings.doubt(scale_doubts(path, seen, scene.mesh, scene.X_WO))
    check_sharpness(path.parent, sharp, findings)
    if scene.mesh is not None and scene.X_WO is not None and len(frames) == len(entries):
        _check_surroundings(path, frames, scene.mesh, scene.X_WO, findings)
    return len(entries)


def _check_view(
    frame: Frame, scene: Scene, findings: Findings, sharp: list[tuple[Path, float | None]], seen: list[Seen]
) -> None:
    picture = attempt(lambda: read_frame_image(frame), findings.error)
    mesh, X_WO = scene.mesh, scene.X_WO
    if mesh is not None and X_WO is not None:
        X_CO = compose(inverse(frame.X_WC), X_WO)
        attempt(lambda: require_outside(frame, X_CO, mesh), findings.error)
        if not in_picture(mesh, frame.camera, X_CO):
            findings.error(unseen(frame.entry["transform_matrix"]))
        elif picture is not None and attempt(lambda: require_seen(frame, X_CO, picture[1], mesh), findings.error):
            outline = silhouette(mesh, frame.camera, X_CO)
            agreement = None if outline is None else compare(outline, picture[1])
            if agreement is not None and agreement.poor:
                found = f"{frame.entry.place}: mask against projected mesh: {agreement.words()}"
                expected = "outlines that agree; check scale, calibration, poses and object.X_WO"
                findings.warn(frame.image_path, found, expected)
    if picture is not None:
        check_area(frame.image_path, picture[1], findings)
        seen.append(Seen(frame.camera, frame.X_WC, seen_size(picture[1])))
        sharp.append((frame.image_path, sharpness(*picture)))


def in_picture(mesh: trimesh.Trimesh, camera: Camera, X_CO: Pose) -> bool:
    """Flag: a camera may see an object [m, O], as a part is in front, and the box around it and the image overlap."""
    pixels, depths = (values.numpy() for values in project(camera, X_CO, torch.from_numpy(np.array(mesh.vertices))))
    if (depths <= 0).any():
        return not (depths <= 0).all()
    return bool((pixels.max(axis=0) > 0).all() and (pixels.min(axis=0) < [camera.width, camera.height]).all())


def unseen(entry: Entry) -> InputError:
    """Return the error of a camera that does not see the object, by the entry of its matrix."""
    return entry.refusal("a pose in OpenGL axes that sees the object", "a camera that does not see the object")


def _check_surroundings(path: Path, frames: list[Frame], mesh: trimesh.Trimesh, X_WO: Pose, findings: Findings) -> None:
    if len(frames) < _FEWEST_VIEWS:
        findings.warn(path, f"{len(frames)} views", f"{_FEWEST_VIEWS} or more, all around the object")
    R_WO, p_WO = quaternion_to_matrix(X_WO.q).numpy(), X_WO.p.numpy()
    middle = np.mean(mesh.bounds, axis=0) @ R_WO.T + p_WO
    away = np.array([frame.X_WC.p.numpy() for frame in frames]) - middle
    flat = np.linalg.norm(away[:, :2], axis=-1) > 0.1 * np.linalg.norm(away, axis=-1)
    azimuths = np.sort(np.degrees(np.arctan2(away[flat, 1], away[flat, 0])))
    gap = float(np.diff(azimuths, append=azimuths[:1] + 360.0).max()) if len(azimuths) else 360.0
    if gap > _WIDEST_GAP:
        findings.warn(path, f"no camera in {gap:.0f} deg of azimuth", f"gaps of {_WIDEST_GAP:g} deg or less")
    normals, centres = mesh.face_normals @ R_WO.T, mesh.triangles_center @ R_WO.T + p_WO
    seen = np.zeros(len(normals), bool)
    for frame in frames:
        seen |= np.einsum("ij,ij->i", normals, frame.X_WC.p.numpy() - centres) > 0
    area = np.where(normals[:, 2] > _DOWN, mesh.area_faces, 0.0)
    share = float(area[~seen].sum() / max(area.sum(), 1e-300))
    if share > _UNSEEN:
        findings.warn(path, f"views that miss {share:.0%} of the surface", "views of all sides, but the one below")
