"""Checks of `capture.yaml` and of the meshes that it names."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh

from pinwm_drake.capture.checks.findings import Findings
from pinwm_drake.capture.objects import (
    CAPTURE_FILE,
    read_mass,
    read_mesh_path,
    read_object,
    read_pose,
    require_version,
)
from pinwm_drake.capture.pusher import pusher_surface
from pinwm_drake.capture.refusals import attempt, passes
from pinwm_drake.capture.scene import PusherGeometry, episode_names, read_floor, read_gravity, read_pusher
from pinwm_drake.documents import Entry, read_yaml
from pinwm_drake.geometry.meshes import load_mesh
from pinwm_drake.spatial.poses import Pose
from pinwm_drake.spatial.rotations import quaternion_to_matrix

_GRAVITY = (9.75, 9.85)  # m/s^2; on the ground it is 9.76 to 9.83
_LARGE = 1.0  # m; objects on a table are smaller
_SUNK = 0.005  # m, between the object's lowest point and the floor
_KEYS = ("schema_version", "units", "gravity", "object", "pusher", "floor")


@dataclass(frozen=True, eq=False)
class Scene:
    """Scene of a capture as far as it could be read; None where a part could not.

    Attributes:
        folder: The capture.
        mesh: The object, m, O.
        X_WO: Pose of the object in the static views and at the start of an episode.
        pusher: The pusher's surface, m, P.
        floor_height: m.
        episode_names: The episodes.
    """

    folder: Path
    mesh: trimesh.Trimesh | None
    X_WO: Pose | None
    pusher: trimesh.Trimesh | None
    floor_height: float | None
    episode_names: list[str]


def check_scene(folder: Path, findings: Findings) -> Scene:
    """Checks `capture.yaml`, key by key, and the meshes.

    Args:
        folder: The capture.
        findings: Receives the problems.

    Returns:
        What could be read.
    """
    names = attempt(lambda: episode_names(folder), findings.error) or []
    document = attempt(lambda: read_yaml(folder / CAPTURE_FILE), findings.error)
    if document is None or not passes(lambda: require_version(document), findings.error):
        return Scene(folder, None, None, None, None, names)
    passes(lambda: document.only(*_KEYS), findings.error)
    mesh, X_WO = _check_object(document, findings)
    geometry = attempt(lambda: read_pusher(document["pusher"], required=bool(names)), findings.error)
    pusher = None if geometry is None or not names else _check_pusher(geometry, findings)
    floor_height = attempt(lambda: read_floor(document["floor"]), findings.error)
    gravity = attempt(lambda: read_gravity(document["gravity"]), findings.error)
    if gravity is not None and not _GRAVITY[0] <= gravity <= _GRAVITY[1]:
        findings.warn(folder / CAPTURE_FILE, f"gravity = {gravity:g}", "9.8 m/s^2, on the ground")
    if mesh is not None and X_WO is not None and floor_height is not None:
        _check_height(folder, mesh, X_WO, floor_height, findings)
    return Scene(folder, mesh, X_WO, pusher, floor_height, names)


def _check_object(document: Entry, findings: Findings) -> tuple[trimesh.Trimesh | None, Pose | None]:
    about = attempt(lambda: document["object"], findings.error)
    if about is None:
        return None, None
    X_WO = attempt(lambda: read_pose(about["X_WO"]), findings.error)
    attempt(lambda: read_mass(about), findings.error)
    path = attempt(lambda: read_mesh_path(about), findings.error)
    attempt(lambda: read_object(about), findings.error)
    mesh = None if path is None else attempt(lambda: load_mesh(path), findings.error)
    if mesh is not None and path is not None:
        extent = float(np.ptp(mesh.vertices, axis=0).max())
        if extent > _LARGE:
            findings.warn(path, f"an extent of {extent:.3g} m", "metres; is it in another unit?")
    return mesh, X_WO


def _check_pusher(geometry: PusherGeometry, findings: Findings) -> trimesh.Trimesh | None:
    """The pusher's surface; its mesh is checked too where a shape takes its place."""
    if geometry.mesh_path is not None and geometry.shape is not None:
        path = geometry.mesh_path
        attempt(lambda: load_mesh(path), findings.error)
    return attempt(lambda: pusher_surface(geometry), findings.error)


def _check_height(folder: Path, mesh: trimesh.Trimesh, X_WO: Pose, floor_height: float, findings: Findings) -> None:
    lowest = float((mesh.vertices @ quaternion_to_matrix(X_WO.q)[2].numpy()).min() + X_WO.p[2])
    gap = lowest - floor_height
    if abs(gap) > _SUNK:
        where = "above" if gap > 0 else "below"
        findings.warn(
            folder / CAPTURE_FILE,
            f"an object whose lowest point at object.X_WO is {1000 * abs(gap):.1f} mm {where} the floor",
            f"an object that rests on the floor (within {1000 * _SUNK:g} mm)",
        )
