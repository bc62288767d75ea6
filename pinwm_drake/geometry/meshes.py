# SPDX-License-Identifier: MIT
"""Triangle meshes: reading them with checks, and their mass properties."""

import os
import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh

from pinwm_drake.errors import GeometryError, InputError, PinwmError
from pinwm_drake.geometry.pieces import ConvexPiece
from pinwm_drake.geometry.shapes import convex_hull
from pinwm_drake.reading.meshes import read_mesh, read_objects

# Extents [m] beyond which a file is taken to be in another unit: objects on a table are in between.
_LARGEST, _SMALLEST = 5.0, 1e-3

# A part whose volume is below this share of that of its convex hull is not convex. Coordinates rounded to
# 1e-6 m cost a part of 10 mm about 1e-4 of its volume.
_CONVEX_SHARE = 1.0 - 1e-3


@dataclass(frozen=True, eq=False)
class MassProperties:
    """Mass properties of a body of uniform density.

    Attributes:
        mass: kg.
        p_com: (3,), m. Centre of mass, in the frame of the mesh.
        inertia: (3, 3), kg m^2. Rotational inertia about the centre of mass, axes of the mesh.
    """

    mass: float
    p_com: np.ndarray
    inertia: np.ndarray


def load_mesh(path: str | os.PathLike[str]) -> trimesh.Trimesh:
    """Read a closed triangle mesh.

    The objects of an OBJ file ("o name") are closed surfaces of their own and may touch or overlap.

    Args:
        path: A file that trimesh reads (OBJ, STL, PLY, GLB), coordinates in metres.

    Returns:
        The mesh, with faces turned outwards and without textures.

    Raises:
        InputError: The file is missing, cannot be read, has no faces or faces that make no sense, has a coordinate
            that is not finite, is not watertight, encloses no volume, or has an extent below 1 mm or above 5 m.
    """
    parts = _load_parts(Path(path))
    starts = np.cumsum([0] + [len(part.vertices) for part in parts])
    vertices = np.concatenate([part.vertices for part in parts])
    faces = np.concatenate([part.faces + start for part, start in zip(parts, starts, strict=False)])
    # Not processed: that would join the corners that two parts share, and open their surfaces.
    return trimesh.Trimesh(vertices, faces, process=False)


def load_pieces(path: str | os.PathLike[str]) -> list[ConvexPiece]:
    """Read a mesh whose closed parts are convex, as decompositions are stored.

    Args:
        path: File of the mesh, as for `load_mesh`.

    Returns:
        The convex hull of each object and each separate component, in the order of the file, frame of the
        mesh.

    Raises:
        InputError: The file is refused as by `load_mesh`, or a part is not convex.
    """
    pieces = []
    for number, part in enumerate(_load_parts(Path(path)), start=1):
        hull = part.convex_hull
        if part.volume < _CONVEX_SHARE * hull.volume:
            raise InputError(
                path,
                value=f"part {number}, which fills {part.volume / hull.volume:.1%} of its convex hull",
                allowed="convex parts; decompose the mesh first (pinwm_drake.geometry.convex.decompose)",
            )
        pieces.append(convex_hull(part.vertices))
    return pieces


def mass_properties(
    mesh: trimesh.Trimesh, *, mass: float | None = None, density: float | None = None
) -> MassProperties:
    """Mass, centre of mass and inertia of a solid of uniform density.

    Args:
        mesh: Watertight, faces turned outwards, m.
        mass: kg; or
        density: kg/m^3.

    Returns:
        The properties.

    Raises:
        GeometryError: Neither or both of mass and density, one that is not positive, or a mesh without
            volume.
    """
    if (mass is None) == (density is None):
        raise GeometryError(f"mass_properties got mass={mass}, density={density}; allowed: exactly one of the two")
    given = mass if mass is not None else density
    if given is None or not np.isfinite(given) or given <= 0.0:
        raise GeometryError(f"mass_properties got mass={mass}, density={density}; allowed: a positive number")
    if not mesh.is_watertight or mesh.volume <= 0.0:
        raise GeometryError("mass_properties got a mesh without a volume; allowed: watertight, faces outwards")
    solid = trimesh.triangles.mass_properties(mesh.triangles, density=1.0)
    scale = given if density is not None else given / solid["volume"]
    return MassProperties(
        mass=float(scale * solid["volume"]),
        p_com=np.array(solid["center_mass"], float),
        inertia=scale * np.array(solid["inertia"], float),
    )


def half_diagonal(mesh: trimesh.Trimesh) -> float:
    """Half the diagonal of a mesh's box along its axes [m]: by how much a turn moves its rim, at the most."""
    return 0.5 * float(np.linalg.norm(mesh.extents))


def _load_parts(path: Path) -> list[trimesh.Trimesh]:
    """Return the closed parts of a file, each checked; InputError whatever the file holds."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # trimesh divides by areas and volumes of nothing
            return _read_parts(path)
    except PinwmError:
        raise
    except Exception as error:  # faces that name corners that are not there, and what else a broken file leads to
        words = next(iter(str(error).splitlines()), "")[:120]
        found = f"a mesh that cannot be used ({type(error).__name__}: {words})"
        raise InputError(path, value=found, allowed="a watertight triangle mesh") from error


def _read_parts(path: Path) -> list[trimesh.Trimesh]:
    """Return the closed parts of a file, each checked; what trimesh raises for a broken file is not caught."""
    if not path.is_file():
        value = "a folder" if path.is_dir() else "no such file"
        raise InputError(path, value=value, allowed="a mesh file: .obj, .stl, .ply or .glb")
    obj = path.suffix.lower() == ".obj"
    objects = [trimesh.Trimesh(*one, process=False) for one in read_objects(path)] if obj else [read_mesh(path)]
    objects = [mesh for mesh in objects if len(mesh.faces)]
    if not objects:
        raise InputError(path, value="no faces", allowed="a mesh with four triangles or more")
    vertices = np.concatenate([mesh.vertices for mesh in objects])
    if not np.all(np.isfinite(vertices)):
        raise InputError(path, value="a coordinate that is not finite", allowed="finite coordinates in metres")
    extent = float(np.ptp(vertices, axis=0).max())
    if not _SMALLEST <= extent <= _LARGEST:
        raise InputError(
            path,
            value=f"an extent of {extent:g} m",
            allowed=f"{_SMALLEST:g} m to {_LARGEST:g} m; is it in millimetres?",
        )
    parts = []
    for mesh in objects:
        mesh.merge_vertices()
        # Not mended: an open mesh is the user's to look at.
        pieces = mesh.split(only_watertight=False, repair=False)
        parts.extend(sorted(pieces, key=lambda part: tuple(part.bounds.ravel())))
    for part in parts:
        if not part.is_watertight or not part.is_winding_consistent:
            raise InputError(path, value="an open surface", allowed="a watertight mesh: two faces at every edge")
        volume = float(part.volume)
        if abs(volume) < 1e-12:
            raise InputError(path, value="a part without volume", allowed="parts of 1 mm^3 or more")
        if volume < 0.0:
            part.invert()
    return parts
