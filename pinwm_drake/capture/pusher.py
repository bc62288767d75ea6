"""The surface of a pusher, whether it is given as a mesh or as a shape."""

import trimesh

from pinwm_drake.capture.scene import PusherGeometry, PusherShape
from pinwm_drake.errors import GeometryError
from pinwm_drake.geometry.meshes import load_mesh


def pusher_surface(pusher: PusherGeometry, *, sections: int = 48) -> trimesh.Trimesh:
    """A pusher's closed surface.

    Args:
        pusher: Its shape, or else its mesh.
        sections: Edges around a round shape, 8 or more.

    Returns:
        m, in frame P. Round shapes are inscribed by 1 % of the radius or less with 48 sections, 3 % with
        24, 10 % with 12.

    Raises:
        InputError: The mesh is refused; see `load_mesh`.
        GeometryError: There is neither.
    """
    if pusher.shape is not None:
        return _shape_surface(pusher.shape, sections)
    if pusher.mesh_path is None:
        raise GeometryError("pusher: got neither a mesh nor a shape; allowed: one of the two")
    return load_mesh(pusher.mesh_path)


def _shape_surface(shape: PusherShape, sections: int) -> trimesh.Trimesh:
    if shape.kind == "sphere":
        subdivisions = 3 if sections > 24 else 2 if sections > 12 else 1
        return trimesh.creation.icosphere(subdivisions=subdivisions, radius=shape.radius)
    if shape.kind == "cylinder":
        return trimesh.creation.cylinder(radius=shape.radius, height=shape.length, sections=sections)
    surface = trimesh.creation.capsule(radius=shape.radius, height=shape.length, count=[sections, sections])
    surface.apply_translation([0.0, 0.0, -0.5 * (surface.bounds[0, 2] + surface.bounds[1, 2])])
    return surface
