"""Draws a straight push that meets the object."""

import math

import numpy as np
import trimesh

from pinwm_drake.capture.pusher import pusher_surface
from pinwm_drake.capture.scene import PusherGeometry, PusherShape
from pinwm_drake.errors import ParameterError
from pinwm_drake.systems.pusher_motion import StraightPush

_GAP = 0.012  # m, between pusher and object at the start
_ACCELERATION = 10.0  # m/s^2: the pusher stops before the object does, up to a friction of 1
_STEEPEST = math.radians(35)  # between the push and the normal of the face that it meets
_SPACING = 0.0015  # m, of the points on the object
_FLAT = 0.010  # m, around the first contact, without an edge
_EDGE = math.radians(45)  # between normals
_SIDEWAYS = 0.6  # of half the width that the object shows the pusher
_ATTEMPTS = 1000
_CLEARANCE = 0.004  # m, between floor and pusher


def choose_push(
    mesh_W: trimesh.Trimesh,
    p_WO: np.ndarray,
    pusher: PusherShape,
    generator: np.random.Generator,
    *,
    height: float,
    speed: float,
    distance: float,
) -> StraightPush:
    """Draws direction and offset of a horizontal push.

    Args:
        mesh_W: The object at rest, m, world.
        p_WO: (3,) m, its centre of mass, world.
        pusher: What pushes.
        generator: Draws them.
        height: Of the pusher's middle, m, world.
        speed: m/s.
        distance: That the pusher goes on after it has met the object, m.

    Returns:
        The push, which starts 12 mm away from the object and meets a face that it is steep to, away from edges: on
        an edge the least difference would decide which side the pusher slides to.

    Raises:
        ParameterError: There is no such face at that height.
    """
    points, normals = _points(mesh_W)
    level = points[:, 2] - height
    if pusher.kind != "sphere":
        level = np.sign(level) * np.maximum(np.abs(level) - 0.5 * pusher.length, 0)
    if pusher.kind == "cylinder":
        level[level != 0] = np.inf
    for _ in range(_ATTEMPTS):
        angle, share = generator.uniform(-math.pi, math.pi), generator.uniform(-_SIDEWAYS, _SIDEWAYS)
        along = np.array([math.cos(angle), math.sin(angle), 0.0])
        across = np.array([-along[1], along[0], 0.0])
        sideways = (points - p_WO) @ across
        offset = share * (sideways.max() if share > 0 else -sideways.min())
        # How far the pusher's middle is from each point's plane when it touches the point.
        reach = pusher.radius**2 - (sideways - offset) ** 2 - level**2
        met = np.flatnonzero(reach > 0)
        if not len(met):
            continue
        touch = (points[met] - p_WO) @ along - np.sqrt(reach[met])
        first = met[np.argmin(touch)]
        if normals[first] @ -along < math.cos(_STEEPEST) or _has_edge(points, normals, first):
            continue
        start = p_WO + (touch.min() - _GAP) * along + offset * across
        start[2] = height
        return StraightPush(start, along, speed, _GAP + distance, _ACCELERATION)
    raise ParameterError(f"pusher: got a height of {height:g} m; allowed: one at which it meets a side of the object")


def _has_edge(points: np.ndarray, normals: np.ndarray, first: np.integer) -> bool:
    """Whether there is an upright edge near a point, on any of the sides of the object."""
    alike = normals @ normals[first]
    near = (np.linalg.norm((points - points[first])[:, :2], axis=1) < _FLAT) & (np.abs(normals[:, 2]) < 0.5)
    # The inside of a thin wall is turned away, and no edge.
    return bool((near & (alike < math.cos(_EDGE)) & (alike > -0.5)).any())


def _points(mesh: trimesh.Trimesh) -> tuple[np.ndarray, np.ndarray]:
    """Points all over a mesh (n, 3) [m], and the normals of their faces (n, 3)."""
    vertices, faces, index = trimesh.remesh.subdivide_to_size(
        mesh.vertices, mesh.faces, _SPACING, max_iter=20, return_index=True
    )
    return vertices[faces].mean(axis=1), mesh.face_normals[index]


def upright_shape(pusher: PusherGeometry) -> PusherShape:
    """A pusher's shape; an upright cylinder around one that is a mesh.

    Raises:
        InputError: The mesh cannot be used.
    """
    if pusher.shape is not None:
        return pusher.shape
    corners = pusher_surface(pusher).vertices
    radius = float(np.linalg.norm(corners[:, :2], axis=1).max())
    return PusherShape("cylinder", radius, 2 * float(np.abs(corners[:, 2]).max()))


def pushing_height(shape: PusherShape, floor_height: float, wanted: float) -> float:
    """Height z of a pusher's middle [m, world]: as wanted, or as near to that as the floor allows."""
    half = 0.5 * shape.length + (0.0 if shape.kind == "cylinder" else shape.radius)
    return max(floor_height + half + _CLEARANCE, wanted)
