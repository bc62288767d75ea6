# SPDX-License-Identifier: MIT
"""Triangles of mesh files, object by object, by positions alone."""

import io
from itertools import pairwise
from pathlib import Path

import numpy as np
import trimesh

from pinwm_drake.errors import InputError
from pinwm_drake.reading.contents import guarded
from pinwm_drake.reading.meshes import mesh_contents

Triangles = tuple[np.ndarray, np.ndarray]  # vertices (n, 3) and faces (m, 3) int


def read_objects(path: Path) -> dict[str, Triangles]:
    """Read the triangles of each object of a mesh file, with the transforms of its scene.

    Args:
        path: An OBJ file, in which each "o name" is an object, or an STL, PLY, OFF or GLB file.

    Raises:
        InputError: It is no regular file, of another kind or too large; a line of an OBJ file makes no sense; its text
            is in an unknown encoding; or trimesh cannot read it.
    """
    data = mesh_contents(path)
    with guarded(path, "a triangle mesh"):
        if path.suffix.lower() == ".obj":
            return _read_obj(path, _decoded(data))
        scene = trimesh.load_scene(
            io.BytesIO(data), file_type=path.suffix.lower()[1:], process=False, skip_materials=True
        )
        objects: dict[str, Triangles] = {}
        for node in scene.graph.nodes_geometry:
            X_SG, name = scene.graph[node]
            mesh = scene.geometry[name]
            if isinstance(mesh, trimesh.Trimesh) and len(mesh.faces):
                faces = np.array(mesh.faces)
                if faces.max() >= len(mesh.vertices) or faces.min() < 0:
                    raise IndexError(f"a face of corner {faces.max()}, of {len(mesh.vertices)}")
                vertices = np.asarray(mesh.vertices, float) @ X_SG[:3, :3].T + X_SG[:3, 3]
                objects[str(node)] = vertices, faces if np.linalg.det(X_SG[:3, :3]) >= 0.0 else faces[:, ::-1]
    return objects


def _decoded(data: bytes) -> str:
    """Text in UTF-8, or in Latin-1 where it is none: letters beyond ASCII are in names alone."""
    try:
        return data.decode()
    except UnicodeDecodeError:
        return data.decode("latin-1")


def _read_obj(path: Path, text: str) -> dict[str, Triangles]:
    """Return the objects of an OBJ file in its order; polygons as fans."""
    points: list[list[float]] = []
    faces: dict[str, list[tuple[int, int, int]]] = {}
    mine: list[tuple[int, int, int]] = faces.setdefault("", [])
    pending = ""
    for number, line in enumerate(text.splitlines(), start=1):
        line = pending + line.split("#", 1)[0].rstrip()
        if line.endswith("\\"):
            pending = line[:-1] + " "
            continue
        pending = ""
        key, *words = line.split() or [""]
        try:
            if key == "v":
                x, y, z = map(float, words[:3])
                points.append([x, y, z])
            elif key == "f":
                corners = [int(word.split("/", 1)[0]) for word in words]
                corners = [corner + len(points) if corner < 0 else corner - 1 for corner in corners]
                if len(corners) < 3 or min(corners) < 0:
                    raise ValueError
                mine += [(corners[0], b, c) for b, c in pairwise(corners[1:])]
            elif key == "o":
                mine = faces.setdefault(" ".join(words), [])
        except ValueError as error:
            found = repr(line.strip()[:60])
            raise InputError(path, row=number, value=found, allowed='"v x y z", "f a b c" or more corners') from error
    vertices = np.array(points, float).reshape(-1, 3)
    objects = {}
    for name, triangles in faces.items():
        if triangles:
            index = np.array(triangles)
            if index.max() >= len(vertices):
                found = f"a face of corner {index.max() + 1}"
                raise InputError(path, value=found, allowed=f"1 to {len(vertices)}, the corners that the file has")
            used, corner = np.unique(index, return_inverse=True)
            objects[name] = vertices[used], corner.reshape(-1, 3)
    return objects
