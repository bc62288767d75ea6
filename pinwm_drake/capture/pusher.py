# SPDX-License-Identifier: MIT
"""Surface, shape and height of a pusher that is given as a mesh or as a shape."""

import numpy as np
import trimesh

from pinwm_drake.capture.scene import PusherGeometry, PusherShape
from pinwm_drake.errors import GeometryError
from pinwm_drake.geometry.meshes import load_mesh

_CLEARANCE = 0.004  # m, between floor and pusher


def pusher_surface(pusher: PusherGeometry, *, sections: int = 48) -> trimesh.Trimesh:
    """Return the closed surface of a pusher, m, frame P: of its shape, or else its mesh.

    Round shapes have 8 or more sections. They are inscribed by 1 % of the radius or less with 48, 3 % with 24, 10 %
    with 12.

    Raises:
        InputError: The mesh is refused; see `load_mesh`.
        GeometryError: There is neither.
    """
    shape = pusher.shape
    if shape is None:
        if pusher.mesh_path is None:
            raise GeometryError("pusher: got neither a mesh nor a shape; allowed: one of the two")
        return load_mesh(pusher.mesh_path)
    if shape.kind == "sphere":
        subdivisions = 3 if sections > 24 else 2 if sections > 12 else 1
        return trimesh.creation.icosphere(subdivisions=subdivisions, radius=shape.radius)
    if shape.kind == "cylinder":
        return trimesh.creation.cylinder(radius=shape.radius, height=shape.length, sections=sections)
    surface = trimesh.creation.capsule(radius=shape.radius, height=shape.length, count=[sections, sections])
    surface.apply_translation([0.0, 0.0, -0.5 * (surface.bounds[0, 2] + surface.bounds[1, 2])])
    return surface


def upright_shape(pusher: PusherGeometry) -> PusherShape:
    """Shape of a pusher; an upright cylinder around one that is a mesh, which InputError refuses if of no use."""
    if pusher.shape is not None:
        return pusher.shape
    corners = pusher_surface(pusher).vertices
    radius = float(np.linalg.norm(corners[:, :2], axis=1).max())
    return PusherShape("cylinder", radius, 2 * float(np.abs(corners[:, 2]).max()))


def pushing_height(shape: PusherShape, floor_height: float, wanted: float) -> float:
    """Height z of a pusher's middle [m, world]: as wanted, or as near to that as the floor allows."""
    half = 0.5 * shape.length + (0.0 if shape.kind == "cylinder" else shape.radius)
    return max(floor_height + half + _CLEARANCE, wanted)
