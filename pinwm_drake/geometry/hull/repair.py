# SPDX-License-Identifier: MIT
"""Repair of meshes: holes filled, faces turned outwards, units guessed, triangles few."""

import warnings
from pathlib import Path

import manifold3d
import numpy as np
import trimesh

from pinwm_drake.errors import InputError
from pinwm_drake.reading.contents import guarded
from pinwm_drake.reading.mesh_objects import read_objects

MOST_TRIANGLES = 2000
_ALLOWED = "a surface whose holes have simple rims; close it in a mesh editor"
_LARGEST, _SMALLEST = 1e9, 1e-9  # of coordinates in any unit; of a surface, of the largest of them
_UNITS = {"m": 1.0, "cm": 0.01, "mm": 1e-3, "inches": 0.0254}
_PLAUSIBLE = 0.01, 1.0  # m, of things that are pushed on a table
_FIRST, _GROWTH, _COARSEST = 1e-4, 1.5, 0.02  # of the diagonal: tolerances of simplification
_JOIN = 1e-5  # of the diagonal: corners nearer to each other are one


def read_repaired(path: Path, extent: float | None = None) -> tuple[trimesh.Trimesh, list[str]]:
    """Read a CAD file or scan as a closed mesh in metres, and say in words what was done to it.

    Args:
        path: OBJ, STL, PLY, OFF or GLB.
        extent: Diagonal of the object, m, where something tells it; the unit is that which comes nearest.

    Raises:
        InputError: The file cannot be read, or its surface cannot be closed.
    """
    objects = read_objects(path)
    if not objects:
        raise InputError(path, value="no faces", allowed="a mesh with four triangles or more")
    parts = [trimesh.Trimesh(vertices, faces, process=False) for vertices, faces in objects.values()]
    mesh = trimesh.util.concatenate(parts)
    assert isinstance(mesh, trimesh.Trimesh)
    largest = float(np.abs(mesh.vertices).max())
    if not largest <= _LARGEST:  # NaN too
        raise InputError(path, value=f"a coordinate of {largest:g}", allowed=f"finite coordinates up to {_LARGEST:g}")
    if not mesh.extents.max() > _SMALLEST * largest:
        raise InputError(path, value="corners in one point", allowed="a surface, not far from its origin")
    unit = guess_unit(float(np.linalg.norm(mesh.extents)), extent)
    done = [] if unit == "m" else [f"read in {unit}: scaled by {_UNITS[unit]:g}"]
    mesh.apply_scale(_UNITS[unit])
    with warnings.catch_warnings(), guarded(path, _ALLOWED):
        warnings.simplefilter("ignore", RuntimeWarning)
        mesh, more = _closed(mesh)
        made = as_manifold(mesh)
    if made is None or made.volume() <= 0:
        is_open = f"is open at {edges} edges" if (edges := _open_edges(mesh)) else "holds no volume"
        found = f"a surface that {is_open}, or crosses itself"
        raise InputError(path, value=found, allowed=_ALLOWED)
    few = simplified(made)
    if few.num_tri() < made.num_tri():
        more.append(f"{made.num_tri()} triangles became {few.num_tri()}")
    return as_mesh(few), done + more


def guess_unit(diagonal: float, extent: float | None) -> str:
    """Unit of a file by its diagonal in that unit, and that of the object [m] where it is known."""
    if extent is not None:
        return min(_UNITS, key=lambda unit: abs(np.log(diagonal * _UNITS[unit] / extent)))
    for unit in ("m", "mm", "cm", "inches"):
        if _PLAUSIBLE[0] <= diagonal * _UNITS[unit] <= _PLAUSIBLE[1]:
            return unit
    return "m" if diagonal < _PLAUSIBLE[0] else "mm"


def _closed(mesh: trimesh.Trimesh) -> tuple[trimesh.Trimesh, list[str]]:
    """Mesh with its corners joined, rims filled and faces turned outwards, and what was done."""
    done = []
    digits = int(np.ceil(-np.log10(_JOIN * float(np.linalg.norm(mesh.extents)))))
    mesh.merge_vertices(merge_tex=True, merge_norm=True, digits_vertex=digits)
    mesh.update_faces(mesh.nondegenerate_faces() & mesh.unique_faces())
    mesh.remove_unreferenced_vertices()
    if not mesh.is_winding_consistent:
        trimesh.repair.fix_winding(mesh)
        done.append("faces wound against each other were turned")
    rims = _rims(mesh)
    if rims:
        filled = [_fill(mesh.vertices, rim) for rim in rims]
        mesh = trimesh.Trimesh(mesh.vertices, np.vstack([mesh.faces, *filled]), process=False)
        done.append(f"{len(rims)} hole{'s' if len(rims) > 1 else ''} filled")
    inwards = sum(part.volume < 0 for part in mesh.split(only_watertight=False))
    if mesh.volume < 0:
        mesh.invert()
        done.append("faces that looked inwards were turned")
    elif inwards:
        done.append(f"{inwards} voids kept")
    return mesh, done


def _rims(mesh: trimesh.Trimesh) -> list[np.ndarray]:
    """Loops of corners along the holes of a mesh, each against the direction of its faces."""
    edges = mesh.edges
    _, group, count = np.unique(np.sort(edges, axis=1), axis=0, return_inverse=True, return_counts=True)
    after = {int(b): int(a) for a, b in edges[count[group.ravel()] == 1]}
    loops = []
    while after:
        start, loop = next(iter(after)), []
        corner = start
        while corner in after:
            loop.append(corner)
            corner = after.pop(corner)
        if corner == start and len(loop) >= 3:
            loops.append(np.array(loop))
    return loops


def _fill(vertices: np.ndarray, rim: np.ndarray) -> np.ndarray:
    """Triangles (n, 3) of a loop of corners, seen along its mean plane."""
    points = vertices[rim] - vertices[rim].mean(axis=0)
    area = np.cross(points, np.roll(points, -1, axis=0)).sum(axis=0)  # counter-clockwise around it
    z = area / np.linalg.norm(area)
    x = np.linalg.svd(points - np.outer(points @ z, z))[2][0]
    flat = np.stack([points @ x, points @ np.cross(z, x)], -1)
    return rim[np.asarray(manifold3d.triangulate([flat]), int)]


def _open_edges(mesh: trimesh.Trimesh) -> int:
    _, count = np.unique(np.sort(mesh.edges, axis=1), axis=0, return_counts=True)
    return int((count != 2).sum())


def simplified(made: manifold3d.Manifold, most: int = MOST_TRIANGLES) -> manifold3d.Manifold:
    """Return a solid with so many triangles at most, its surface moved as little as that takes."""
    low, high = np.array(made.bounding_box()).reshape(2, 3)
    diagonal, tolerance = float(np.linalg.norm(high - low)), _FIRST
    while made.num_tri() > most and tolerance <= _COARSEST:
        made, tolerance = made.simplify(tolerance * diagonal), tolerance * _GROWTH
    return made


def as_manifold(mesh: trimesh.Trimesh) -> manifold3d.Manifold | None:
    """Solid with a surface [m]; None where that is no surface of a solid."""
    a, b = np.asarray(mesh.edges, np.int64).T
    there, back = a * len(mesh.vertices) + b, b * len(mesh.vertices) + a
    if not np.array_equal(np.sort(there), np.sort(back)):  # manifold3d 3.5 ends the process for an odd number of edges
        return None
    # Copies: manifold3d takes no arrays that cannot be written to.
    made = manifold3d.Manifold(manifold3d.Mesh64(np.array(mesh.vertices, float), np.array(mesh.faces, np.uint64)))
    return made if made.status() == manifold3d.Error.NoError and made.num_tri() > 0 else None


def as_mesh(made: manifold3d.Manifold) -> trimesh.Trimesh:
    """Surface of a solid, as a mesh."""
    mesh = made.to_mesh64()
    return trimesh.Trimesh(mesh.vert_properties[:, :3], np.asarray(mesh.tri_verts, int), process=False)
