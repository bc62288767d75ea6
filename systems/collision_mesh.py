"""Meshes and shapes for Drake's hydroelastic contact."""

import numpy as np
import trimesh
from pydrake.common import MemoryFile
from pydrake.geometry import Capsule, Cylinder, InMemoryMesh, Mesh, Shape, Sphere

from pinwm_drake.capture.scene import PusherShape


def fine_mesh(mesh: trimesh.Trimesh, longest_edge: float) -> Mesh:
    """The mesh with its triangles divided, as a shape for contact.

    Drake puts one contact at the centroid of every polygon of a contact surface; on a floor these are the object's
    triangles. Two large ones would neither hold a box upright nor show the friction torque of its face.

    Args:
        mesh: Metres, watertight.
        longest_edge: Of a triangle, m.

    Returns:
        The shape, its mesh held in memory.
    """
    corners = divided(mesh.triangles, longest_edge).reshape(-1, 3)
    lines = [f"v {x:.12g} {y:.12g} {z:.12g}" for x, y, z in corners]
    lines += [f"f {k + 1} {k + 2} {k + 3}" for k in range(0, len(corners), 3)]
    content = ("\n".join(lines) + "\n").encode()
    return Mesh(InMemoryMesh(mesh_file=MemoryFile(content, ".obj", "object")))


def divided(triangles: np.ndarray, longest_edge: float) -> np.ndarray:
    """Triangles halved across their longest edge until none is longer than allowed.

    Args:
        triangles: (n, 3, 3) m.
        longest_edge: m.

    Returns:
        (m, 3, 3) m, the same surface, turned the same way.
    """
    done = []
    while len(triangles):
        lengths = np.linalg.norm(np.roll(triangles, -1, axis=1) - triangles, axis=2)
        long = lengths.max(axis=1) > longest_edge
        done.append(triangles[~long])
        # Turned so that the edge from corner 0 to corner 1 is the longest.
        first = lengths[long].argmax(axis=1)
        a, b, c = (triangles[long, (first + k) % 3] for k in range(3))
        middle = 0.5 * (a + b)
        triangles = np.concatenate([np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)])
    return np.concatenate(done)


def drake_shape(pusher: PusherShape) -> Shape:
    """The pusher as a shape of Drake, its middle at the origin and its axis along z."""
    if pusher.kind == "sphere":
        return Sphere(pusher.radius)
    return {"capsule": Capsule, "cylinder": Cylinder}[pusher.kind](pusher.radius, pusher.length)


def triangle_mesh(pusher: PusherShape) -> trimesh.Trimesh:
    """The pusher as a closed triangle mesh, m, frame P."""
    if pusher.kind == "sphere":
        return trimesh.creation.icosphere(subdivisions=3, radius=pusher.radius)
    if pusher.kind == "capsule":
        mesh = trimesh.creation.capsule(height=pusher.length, radius=pusher.radius, count=[32, 32])
        mesh.apply_translation(-mesh.bounds.mean(axis=0))
        return mesh
    return trimesh.creation.cylinder(radius=pusher.radius, height=pusher.length, sections=64)
