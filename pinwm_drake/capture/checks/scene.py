# SPDX-License-Identifier: MIT
"""Checks of `capture.yaml` and of the meshes that it names."""

from dataclasses import dataclass
from pathlib import Path

import trimesh

from pinwm_drake.capture.checks.findings import Findings
from pinwm_drake.capture.pusher import pusher_surface
from pinwm_drake.capture.refusals import attempt, ignore
from pinwm_drake.capture.scene import (
    CAPTURE_FILE,
    GRAVITIES,
    CaptureDocument,
    FloorDocument,
    HeadDocument,
    PoseDocument,
    PusherDocument,
    episode_names,
    object_mesh,
    pusher_geometry,
)
from pinwm_drake.capture.units import PUSHER_EXTENT, scene_doubts, size_doubts
from pinwm_drake.documents import Entry, read_yaml
from pinwm_drake.geometry.meshes import load_mesh
from pinwm_drake.spatial.poses import Pose
from pinwm_drake.spatial.rotations import quaternion_to_matrix

_SUNK = 0.005  # m, between the object's lowest point and the floor


@dataclass(frozen=True, eq=False)
class Scene:
    """Scene of a capture as far as it could be read; None where a part could not."""

    folder: Path
    mesh: trimesh.Trimesh | None  # m, O
    X_WO: Pose | None  # in the static views and at the start of an episode
    pusher: trimesh.Trimesh | None  # m, P
    floor_height: float | None  # m
    episode_names: list[str]


def check_scene(folder: Path, findings: Findings) -> Scene:
    """Check `capture.yaml`, key by key, and the meshes; return what could be read."""
    names = attempt(lambda: episode_names(folder), findings.error) or []
    document = attempt(lambda: read_yaml(folder / CAPTURE_FILE), findings.error)
    if document is None or attempt(lambda: document.read(HeadDocument), findings.error) is None:
        return Scene(folder, None, None, None, None, names)
    for problem in document.problems(CaptureDocument):
        findings.error(problem)
    # The parts that are right serve further checks.
    mesh = _check_mesh(folder, document, findings)
    X_WO = attempt(lambda: document["object"]["X_WO"].read(PoseDocument).pose(), ignore)
    pusher = _check_pusher(document, findings) if names else None
    floor_height = attempt(lambda: document["floor"].read(FloorDocument).height, ignore)
    gravity = attempt(lambda: document["gravity"].number(*GRAVITIES), ignore)
    mass = attempt(lambda: document["object"]["mass"].number(), ignore)
    findings.doubt(
        scene_doubts(folder / CAPTURE_FILE, mesh=mesh, X_WO=X_WO, floor_height=floor_height, gravity=gravity, mass=mass)
    )
    if mesh is not None and X_WO is not None and floor_height is not None:
        _check_height(folder, mesh, X_WO, floor_height, findings)
    return Scene(folder, mesh, X_WO, pusher, floor_height, names)


def _check_mesh(folder: Path, document: Entry, findings: Findings) -> trimesh.Trimesh | None:
    name = attempt(lambda: document["object"]["mesh"].text(), ignore)
    path = None if name is None else attempt(lambda: object_mesh(folder, name), findings.error)
    mesh = None if path is None else attempt(lambda: load_mesh(path), findings.error)
    if mesh is not None and path is not None:
        findings.doubt(size_doubts(path, mesh))
    return mesh


def _check_pusher(document: Entry, findings: Findings) -> trimesh.Trimesh | None:
    """Return the pusher's surface; its mesh is checked too where a shape takes its place."""
    about = attempt(lambda: document["pusher"].read(PusherDocument), ignore)
    if about is None:
        return None
    geometry = attempt(lambda: pusher_geometry(document["pusher"], about, required=True), findings.error)
    if geometry is None:
        return None
    path = geometry.mesh_path
    if path is not None and geometry.shape is not None:
        attempt(lambda: load_mesh(path), findings.error)
    surface = attempt(lambda: pusher_surface(geometry), findings.error)
    if surface is not None:
        place = path if path is not None and geometry.shape is None else document.path
        findings.doubt(size_doubts(place, surface, PUSHER_EXTENT))
    return surface


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
