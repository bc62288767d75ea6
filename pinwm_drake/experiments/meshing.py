# SPDX-License-Identifier: MIT
"""Mesh of a capture's object: a file that is repaired, depths that are fused, or the hull of its masks."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh

from pinwm_drake.capture.amend import amend
from pinwm_drake.capture.images import size_of
from pinwm_drake.capture.paths import is_file
from pinwm_drake.capture.scene import CAPTURE_FILE, load_unfinished
from pinwm_drake.capture.static_views import TRANSFORMS
from pinwm_drake.documents import read_yaml
from pinwm_drake.errors import InputError
from pinwm_drake.experiments.masking import read_shots
from pinwm_drake.experiments.start import POOR
from pinwm_drake.files import prepare_folder, replacing
from pinwm_drake.geometry.hull.repair import read_repaired
from pinwm_drake.geometry.hull.surface import UPRIGHT, hull_meshes
from pinwm_drake.geometry.hull.visual import Grid, carve
from pinwm_drake.geometry.meshes import load_mesh
from pinwm_drake.masks.shots import Shot, aimed_at
from pinwm_drake.masks.start_pose import Outlines, StartPose, find_start_pose
from pinwm_drake.reading.pictures import opened_picture

HULL_ERROR = 1.9e-3  # m, of the sides of a hull: see docs/how-to/photos-of-an-object.md
_REACH, _VOXELS = 0.31, 72  # as in pinwm_drake/masks: of the distance of the cameras; along the diameter
_KINDS = {"file": "the file", "depths": "depths within the hull of the masks", "hull": "the hull of the masks"}
_SCALES = {"I;16": 1e-3, "I;16B": 1e-3, "I;16L": 1e-3, "F": 1.0}  # m, of a unit in pictures of a mode of Pillow


@dataclass(frozen=True, eq=False)
class Meshed:
    """Mesh of an object.

    Attributes:
        path: File of the mesh.
        mesh: The mesh, m, frame O.
        kind: "file", "depths" or "hull".
        done: What was done to it, in words.
        pose: Pose of the mesh by the masks; None where there are none.
        warnings: What is doubtful, in words.
    """

    path: Path
    mesh: trimesh.Trimesh
    kind: str
    done: list[str]
    pose: StartPose | None
    warnings: list[str]

    def words(self) -> list[str]:
        """What was made of which source, one line each; doubts begin with "doubtful: "."""
        size = " x ".join(f"{1e3 * x:.1f}" for x in self.mesh.extents)
        about = f"{len(self.mesh.faces)} triangles, {size} mm, {1e6 * self.mesh.volume:.1f} cm³"
        lines = [f"{_KINDS[self.kind]}: {about}", *self.done]
        if self.pose is not None:
            lines.append(f"outlines of the mesh and masks differ by {100 * self.pose.differing:.1f} % of the object")
        return [*lines, *(f"doubtful: {one}" for one in self.warnings)]


def make_mesh(folder: Path, *, source: Path | None = None, out: Path | None = None, replace: bool = False) -> Meshed:
    """Write a closed mesh of a capture's object, in metres, of 2,000 triangles at most.

    Args:
        folder: The capture.
        source: CAD file or scan; None for the depths in `static/depth`, or else the hull of the masks.
        out: File of the mesh; None for `meshes/object.obj` of the capture.
        replace: Flag: a mesh that is there is replaced.

    Raises:
        InputError: A file is refused or there already, or there is nothing to make a mesh of.
    """
    capture, out = load_unfinished(folder), out or folder / "meshes/object.obj"
    if out.exists() and not replace:
        raise InputError(out, value="a file that is there already", allowed="another --out, or --replace")
    static = folder / "static"
    shots, known, _ = read_shots(static) if (static / TRANSFORMS).is_file() else ([], {}, set())
    rows = sorted(known)
    shots, masks = [shots[k] for k in rows], [known[k] for k in rows]
    points, coarse = _coarse_hull(shots, masks, capture.floor_height)
    doubts: list[str] = []
    if source is not None:
        extent = float(np.linalg.norm(np.ptp(points, axis=0))) if len(points) else None
        mesh, done = read_repaired(source, extent)
        kind = "file"
    else:
        if not len(points):
            raise InputError(static, value="no masks that agree on a thing", allowed="masks, or a file: --from FILE")
        depths = read_depths(static, shots)
        pieces = hull_meshes(masks, [s.P for s in shots], points, coarse, capture.floor_height, depths)
        if not pieces:
            raise InputError(static, value="no thing that all masks show", allowed="masks that agree")
        mesh, kind, done = pieces[0], "hull" if depths is None else "depths", []
        doubts += [_left_out(piece, mesh) for piece in pieces[1:]]
        middle = mesh.bounds.mean(axis=0) * [1, 1, 0] + [0, 0, capture.floor_height]
        mesh.apply_translation(-middle)
        if mesh.metadata.get(UPRIGHT):
            done.append("its sides stand upright: it is a prism with one outline of all heights and a level top")
        if kind == "hull":
            doubts.append(
                "this is the hull of the masks: cups are filled, the top is as flat as the outlines allow, and sides "
                f"are off by {1e3 * HULL_ERROR:.1f} mm on average"
            )
    pose = find_start_pose(Outlines.of(shots, masks), mesh, capture.floor_height) if shots else None
    if pose is not None and pose.differing > POOR:
        doubts.append(f"outlines of the mesh and masks differ by {pose.differing:.0%} of the object: look at the masks")
    prepare_folder(out.parent)
    with replacing(out) as temporary:
        mesh.export(temporary, file_type="obj")
        load_mesh(temporary)
    return Meshed(out, mesh, kind, done, pose, doubts)


def write_mesh_error(folder: Path, kind: str) -> list[str]:
    """Write to `capture.yaml` how far the sides of a hull are off; take that away for a mesh of another kind.

    What a person wrote there stays.

    Args:
        folder: The capture; without a `capture.yaml` nothing is written.
        kind: Kind of its mesh, as `Meshed` has it.

    Returns:
        Lines of doubt, which begin with "doubtful: ".

    Raises:
        InputError: The file is refused.
    """
    path = folder / CAPTURE_FILE
    if not is_file(path):
        return []
    about = read_yaml(path).find("object")
    entry = None if about is None or about.value is None else about.find("mesh_error")
    before = None if entry is None else entry.value
    if kind != "hull":
        return amend(path, {("object", "mesh_error"): 0.0}) if before == HULL_ERROR else []
    if before in (None, 0, HULL_ERROR):
        return amend(path, {("object", "mesh_error"): HULL_ERROR})
    return [f"doubtful: {path.name} keeps object.mesh_error = {before}; sides of a hull are off by {HULL_ERROR} m"]


def read_depths(static: Path, shots: Sequence[Shot]) -> list[np.ndarray] | None:
    """Depths (H, W) float32 [m] along the cameras' axes, 0 where unknown; None where there is no folder `depth`.

    `static/depth` has a PNG of 16 bits for each image, in mm, or a TIFF of floats, in m, of the same name and size.

    Raises:
        InputError: A file is missing, of another kind, or of another size.
    """
    folder, depths = static / "depth", []
    if not folder.is_dir():
        return None
    for shot in shots:
        paths = [folder / f"{Path(shot.name).stem}{end}" for end in (".png", ".tif", ".tiff")]
        path = next((path for path in paths if path.is_file()), None)
        if path is None:
            raise InputError(paths[0], value="no such file", allowed=f"the depths of {shot.name}")
        with opened_picture(path) as picture:
            if picture.mode not in _SCALES:
                found = f"mode {picture.mode}"
                raise InputError(path, value=found, allowed="16-bit PNG in mm, or float TIFF in m, grey")
            depth = np.asarray(picture).astype(np.float32) * np.float32(_SCALES[picture.mode])
        if depth.shape != shot.shape:
            allowed = f"{shot.shape[1]} x {shot.shape[0]} px, the size of {shot.name}"
            raise InputError(path, value=size_of(depth), allowed=allowed)
        depths.append(np.nan_to_num(depth, posinf=0.0))
    return depths


def _left_out(piece: trimesh.Trimesh, mesh: trimesh.Trimesh) -> str:
    """Words on a piece that is no part of a mesh; both m, world."""
    x, y, z = 1e3 * piece.bounds.mean(axis=0)
    where = f"at ({x:.0f}, {y:.0f}, {z:.0f}) mm"
    return f"a piece {where} is left out, {piece.volume / mesh.volume:.1%} as large as the mesh: look at the masks"


def _coarse_hull(shots: Sequence[Shot], masks: Sequence[np.ndarray], floor: float) -> tuple[np.ndarray, float]:
    """Points (n, 3) [m] of the hull of masks, few of which may be wrong, and their distance [m]."""
    if len(shots) < 3:
        return np.zeros((0, 3)), 0.0
    middle = aimed_at(shots)
    middle[2] = floor
    radius = _REACH * float(np.median([np.linalg.norm(shot.p_WC - middle) for shot in shots]))
    low, high = middle - radius, middle + radius
    low[2], high[2] = floor, floor + 2 * radius
    grid = Grid.between(low, high, 2 * radius / _VOXELS)
    flags = carve(masks, [shot.P for shot in shots], grid, len(shots) // 12)
    return grid.points()[flags.ravel()].astype(float), grid.voxel
