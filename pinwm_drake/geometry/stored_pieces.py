# SPDX-License-Identifier: MIT
"""Convex pieces of mesh files, which are found once: stored beside a mesh, or in the user's cache by its content."""

import functools
import hashlib
import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import trimesh

from pinwm_drake.errors import InputError
from pinwm_drake.files import replacing
from pinwm_drake.geometry.convex import decompose
from pinwm_drake.geometry.meshes import load_mesh, load_pieces, outer_mesh
from pinwm_drake.geometry.pieces import ConvexPiece
from pinwm_drake.geometry.primitive import Primitive, primitives_of
from pinwm_drake.geometry.shapes import convex_hull
from pinwm_drake.reading.arrays import read_npz
from pinwm_drake.reading.contents import read_bytes

# Folder of pieces beside a mesh, one OBJ file each.
BESIDE = "pieces"
# Pieces belong to a mesh if they reach as far, relative to its size, and fill as much, relative to its volume.
_REACH, _FILL = 1e-3, 0.05
# Belongs to the content: another way of decomposing makes other pieces.
_WAY = b"coacd 0.05 32 0"


def mesh_pieces(path: str | os.PathLike[str]) -> list[ConvexPiece]:
    """Convex pieces of a mesh: its parts where they are convex, else those stored beside it, else its decomposition.

    A decomposition takes half a minute. It is kept in the user's cache (`XDG_CACHE_HOME`, or `~/.cache`) by the SHA-256
    of the mesh, so that no mesh is decomposed twice.

    Args:
        path: File of the mesh, as for `load_mesh`; a folder `pieces` beside it may hold its pieces, one OBJ file each.

    Returns:
        The pieces, frame of the mesh.

    Raises:
        InputError: The file is refused as by `load_mesh`.
        GeometryError: The mesh cannot be decomposed.
    """
    path = Path(path)
    try:
        return load_pieces(path)
    except InputError:
        mesh = load_mesh(path)
    beside = sorted((path.parent / BESIDE).glob("*.obj"))
    if beside and (pieces := _beside(path, tuple(beside), tuple(map(_digest, (path, *beside))))):
        return list(pieces)
    store = cache_folder() / f"{hashlib.sha256(_WAY + read_bytes(path)).hexdigest()}.npz"
    stored = _read(store)
    if stored is None:
        stored = [piece.vertices for piece in decompose(mesh)]
        _write(store, stored)
    return [convex_hull(vertices) for vertices in stored]


def mesh_primitives(path: str | os.PathLike[str]) -> tuple[Primitive, ...]:
    """Primitives that a mesh acts as, frame of the mesh; none where it acts as its pieces.

    Args:
        path: File of the mesh, as for `mesh_pieces`.

    Raises:
        InputError: The file is refused as by `load_mesh`.
        GeometryError: The mesh cannot be decomposed.
    """
    path = Path(path)
    return _primitives(path, _digest(path))


@functools.lru_cache(maxsize=64)
def _primitives(path: Path, digest: str) -> tuple[Primitive, ...]:
    """`mesh_primitives` of a file with a hash: a process asks for those of a scenario again and again."""
    return primitives_of(load_mesh(path), mesh_pieces(path))


@functools.lru_cache(maxsize=64)
def _beside(path: Path, files: tuple[Path, ...], digests: tuple[str, ...]) -> tuple[ConvexPiece, ...]:
    """Pieces in files beside a mesh, all with hashes; none where they do not belong to it."""
    pieces = tuple(piece for file in files for piece in load_pieces(file))
    return pieces if _belong(pieces, load_mesh(path)) else ()


def _digest(path: Path) -> str:
    return hashlib.sha256(read_bytes(path)).hexdigest()


def cache_folder() -> Path:
    """Folder of the decompositions that this user has made."""
    root = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(root) / "pinwm_drake" / "pieces"


def _belong(pieces: Sequence[ConvexPiece], mesh: trimesh.Trimesh) -> bool:
    """Return True where pieces reach as far as a mesh and fill as much as it does with its closed voids."""
    points = np.concatenate([piece.vertices for piece in pieces])
    apart = np.abs(np.stack([points.min(0), points.max(0)]) - mesh.bounds).max()
    volume = sum(trimesh.convex.convex_hull(piece.vertices).volume for piece in pieces)
    filled = outer_mesh(mesh).volume
    return bool(apart <= _REACH * mesh.extents.max() and abs(volume - filled) <= _FILL * filled)


def _read(path: Path) -> list[np.ndarray] | None:
    """Vertices of stored pieces, or None where there are none that can be read."""
    try:
        arrays = read_npz(path, "pieces of a mesh")
        vertices, counts = arrays["vertices"], arrays["counts"]
    except (InputError, KeyError):
        return None
    return np.split(vertices, np.cumsum(counts)[:-1])


def _write(path: Path, pieces: list[np.ndarray]) -> None:
    """Store the vertices of pieces; a cache that cannot be written is left alone."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with replacing(path) as temporary, temporary.open("wb") as file:
            np.savez(file, vertices=np.concatenate(pieces), counts=np.array([len(piece) for piece in pieces]))
    except (OSError, InputError):
        return
