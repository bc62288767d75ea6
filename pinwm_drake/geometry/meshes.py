# SPDX-License-Identifier: MIT
"""Triangle meshes: reading them with checks, and their mass properties."""

import os
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

import numpy as np
import trimesh

from pinwm_drake.errors import GeometryError, InputError, PinwmError
from pinwm_drake.geometry.pieces import ConvexPiece
from pinwm_drake.geometry.shapes import convex_hull
from pinwm_drake.geometry.shells import Shell, closed_shells
from pinwm_drake.geometry.solid import outer, solid
from pinwm_drake.reading.mesh_objects import Triangles, read_objects

Result = TypeVar("Result")

# Extents [m] beyond which a file is taken to be in another unit: objects on a table are in between.
_LARGEST, _SMALLEST = 5.0, 1e-3

# A part whose volume is below this share of that of its convex hull is not convex. Coordinates rounded to
# 1e-6 m cost a part of 10 mm about 1e-4 of its volume.
_CONVEX_SHARE = 1.0 - 1e-3
_SOLID = "pinwm_solid"  # metadata of a mesh: its hash when it was made the surface of a solid


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
    """Read a closed triangle mesh as the surface of a solid, in which voids subtract and overlaps count once.

    Corners at the same position are one, whatever seams of materials or texture there are. The rule of windings is that
    of `solid`: a shell in another is a void where it is wound the other way, and else a body that counts once.

    Args:
        path: A file that trimesh reads (OBJ, STL, PLY, OFF, GLB, GLTF), coordinates in metres.

    Returns:
        The mesh, with faces turned out of the material and without textures. Bodies that only touch stay apart.

    Raises:
        InputError: The file is missing, cannot be read, has no faces or faces that make no sense, has a coordinate
            that is not finite, is not closed, encloses no volume, or has an extent below 1 mm or above 5 m.
    """
    mesh = _guarded(Path(path), lambda path: _as_mesh(solid(_read_shells(path))))
    mesh.metadata[_SOLID] = hash(mesh)
    return mesh


def load_pieces(path: str | os.PathLike[str]) -> list[ConvexPiece]:
    """Read a mesh whose closed parts are convex, as decompositions are stored.

    Args:
        path: File of the mesh, as for `load_mesh`.

    Returns:
        The convex hull of each object and each separate component that is in no other, in the order of the file, frame
        of the mesh. Closed voids are left out, as nothing can touch them.

    Raises:
        InputError: The file is refused as by `load_mesh`, or a part is not convex.
    """
    pieces = []
    for number, shell in enumerate(_guarded(Path(path), lambda path: outer(_read_shells(path))), start=1):
        part = _as_mesh([shell])
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
    """Mass, centre of mass and inertia of a solid of uniform density, in which voids subtract and overlaps count once.

    Args:
        mesh: Closed by its positions, m; windings mean what they do for `load_mesh`.
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
    try:
        whole = mesh if mesh.metadata.get(_SOLID) == hash(mesh) else _as_mesh(solid(_shells_of(mesh)))
    except GeometryError as error:
        raise GeometryError(f"mass_properties got {error}; allowed: a closed mesh around a volume") from error
    about = trimesh.triangles.mass_properties(whole.triangles, density=1.0)
    scale = given if density is not None else given / about["volume"]
    return MassProperties(
        mass=float(scale * about["volume"]),
        p_com=np.array(about["center_mass"], float),
        inertia=scale * np.array(about["inertia"], float),
    )


def half_diagonal(mesh: trimesh.Trimesh) -> float:
    """Half the diagonal of a mesh's box along its axes [m]: by how much a turn moves its rim, at the most."""
    return 0.5 * float(np.linalg.norm(mesh.extents))


def outer_mesh(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """Return a mesh without its closed voids and what is in them: the surface that others can touch.

    Raises:
        GeometryError: The mesh is not closed.
    """
    return _as_mesh(outer(_shells_of(mesh)))


def _shells_of(mesh: trimesh.Trimesh) -> list[Shell]:
    shells = closed_shells(np.asarray(mesh.vertices, float), np.asarray(mesh.faces))
    return [replace(shell, name=f"part {number}") for number, shell in enumerate(shells, start=1)]


def _guarded(path: Path, read: Callable[[Path], Result]) -> Result:
    """Read a file; InputError whatever it holds."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # trimesh divides by areas and volumes of nothing
            return read(path)
    except GeometryError as error:
        raise InputError(path, value=error, allowed="a watertight mesh: two faces at every edge") from error
    except PinwmError:
        raise
    except Exception as error:  # faces that name corners that are not there, and what else a broken file leads to
        words = next(iter(str(error).splitlines()), "")[:120]
        found = f"a mesh that cannot be used ({type(error).__name__}: {words})"
        raise InputError(path, value=found, allowed="a watertight triangle mesh") from error


def require_extent(path: Path, vertices: np.ndarray) -> None:
    """Require finite vertices (n, 3) [m], of a file at `path`, whose extent is 1 mm to 5 m.

    Raises:
        InputError: They are not.
    """
    if not np.all(np.isfinite(vertices)):
        raise InputError(path, value="a coordinate that is not finite", allowed="finite coordinates in metres")
    extent = float(np.ptp(vertices, axis=0).max())
    if not _SMALLEST <= extent <= _LARGEST:
        raise InputError(
            path,
            value=f"an extent of {extent:g} m",
            allowed=f"{_SMALLEST:g} m to {_LARGEST:g} m; is it in millimetres?",
        )


def _read_shells(path: Path) -> list[Shell]:
    """Return the closed shells of a file, object by object."""
    if not path.is_file():
        value = "a folder" if path.is_dir() else "no such file"
        raise InputError(path, value=value, allowed="a mesh file: .obj, .stl, .ply, .off or .glb")
    objects = read_objects(path)
    if not objects:
        raise InputError(path, value="no faces", allowed="a mesh with four triangles or more")
    vertices = np.concatenate([vertices[np.unique(faces)] for vertices, faces in objects.values()])
    require_extent(path, vertices)
    shells: list[Shell] = []
    open_ones: list[Triangles] = []
    for triangles in objects.values():
        try:
            shells += closed_shells(*triangles)
        except GeometryError:  # one material, or one side, of a body that others close
            open_ones.append(triangles)
    if open_ones:
        shells += closed_shells(*_joined(open_ones))
    return [replace(shell, name=f"part {number}") for number, shell in enumerate(shells, start=1)]


def _joined(objects: Sequence[Triangles]) -> Triangles:
    starts = np.cumsum([0] + [len(vertices) for vertices, _ in objects])
    faces = [faces + start for (_, faces), start in zip(objects, starts, strict=False)]
    return np.concatenate([vertices for vertices, _ in objects]), np.concatenate(faces)


def _as_mesh(shells: Sequence[Shell]) -> trimesh.Trimesh:
    """Return shells as one mesh, not processed: that would join the corners that two share, and open their surfaces."""
    return trimesh.Trimesh(*_joined([(shell.vertices, shell.faces) for shell in shells]), process=False)
