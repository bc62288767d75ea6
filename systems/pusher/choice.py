# SPDX-License-Identifier: MIT
"""Choice of straight pushes: random ones that meet the object, and the speed of the pusher."""

import functools
import math

import numpy as np
import trimesh
from pydrake.math import RigidTransform

from pinwm_drake.capture.pusher import pushing_height, upright_shape
from pinwm_drake.capture.scene import PusherShape
from pinwm_drake.errors import ParameterError
from pinwm_drake.geometry.meshes import load_mesh, mass_properties
from pinwm_drake.systems.pusher.motion import StraightPush
from pinwm_drake.systems.scenario.setup import Setup

_GAP = 0.012  # m, between pusher and object at the start
_ACCELERATION = 10.0  # m/s^2: the pusher stops before the object does, up to a friction of 1
_STEEPEST = math.radians(35)  # between the push and the normal of the face that it meets
_SPACING = 0.0015  # m, of the points on the object
_FLAT = 0.010  # m, around the first contact, without an edge
_EDGE = math.radians(45)  # between normals
_SIDEWAYS = 0.6  # of half the width that the object shows the pusher
_ATTEMPTS = 1000
COASTING = 0.022  # m, by which an object slides on that is as fast as the pusher
SPEEDS = (0.08, 0.5)  # m/s
_DISTANCE = 0.10  # m, that the pusher goes on after it has met the object
_PUSHES_DRAWN = 20
_POKE_GAP, _POKE_ACCELERATION, _POKE_DELAY = 0.003, 200.0, 0.05  # m, m/s^2, s
_SLOW = 0.1  # m/s, of the level push whose start and direction a poke takes
_HEIGHTS = (0.3, 1.2)  # of the centre of mass over the floor, at which a poke begins
_POKE_SPEEDS, _RISES = (0.6, 1.0), (0.3, 1.1)  # m/s; rad, of the way over level
_POKE_DISTANCES = (0.04, 0.09)  # m, that the pusher goes on after it has met the object


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
        pusher: Shape of the pusher.
        generator: Source of randomness.
        height: Height of the pusher's middle, m, world.
        speed: Speed of the pusher, m/s.
        distance: Distance that the pusher goes on after it has met the object, m.

    Returns:
        The push, which starts 12 mm away from the object, where something above can hold the pusher, and meets a face
        that it is steep to, away from edges: on an edge the least difference would decide which side the pusher slides
        to.

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
        if _is_covered(points, start):
            continue
        return StraightPush(start, along, speed, _GAP + distance, _ACCELERATION)
    raise ParameterError(f"pusher: got a height of {height:g} m; allowed: one at which it meets a side of the object")


def choose_poke(
    mesh_W: trimesh.Trimesh,
    p_WB: np.ndarray,
    pusher: PusherShape,
    generator: np.random.Generator,
    *,
    floor_height: float,
    speeds: tuple[float, float] = _POKE_SPEEDS,
    rises: tuple[float, float] = _RISES,
    distances: tuple[float, float] = _POKE_DISTANCES,
) -> StraightPush:
    """Draws a poke: short, fast, upwards and straight, from 3 mm off a side of the object.

    Args:
        mesh_W, p_WB, pusher, generator: Object, its centre of mass, and the rest as for `choose_push`.
        floor_height: m, world: z of the floor.
        speeds: m/s, least and most.
        rises: rad, of the way over level, least and most.
        distances: m, that the pusher goes on after it has met the object, least and most.

    Returns:
        The poke; where it begins and which side it meets is drawn as `choose_push` draws it.

    Raises:
        ParameterError: There is no side to be met at the height that was drawn.
    """
    wanted = floor_height + generator.uniform(*_HEIGHTS) * (p_WB[2] - floor_height)
    height = pushing_height(pusher, floor_height, wanted)
    speed, rise, distance = generator.uniform(*speeds), generator.uniform(*rises), generator.uniform(*distances)
    level = choose_push(mesh_W, p_WB, pusher, generator, height=height, speed=_SLOW, distance=distance)
    direction = np.array([*(math.cos(rise) * level.direction_W[:2]), math.sin(rise)])
    start = level.p_WP + (_GAP - _POKE_GAP) * level.direction_W
    return StraightPush(start, direction, speed, _POKE_GAP + distance, _POKE_ACCELERATION, _POKE_DELAY)


def _has_edge(points: np.ndarray, normals: np.ndarray, first: np.integer) -> bool:
    alike = normals @ normals[first]
    near = (np.linalg.norm((points - points[first])[:, :2], axis=1) < _FLAT) & (np.abs(normals[:, 2]) < 0.5)
    # The inside of a thin wall is turned away, and no edge.
    return bool((near & (alike < math.cos(_EDGE)) & (alike > -0.5)).any())


def _is_covered(points: np.ndarray, place: np.ndarray) -> bool:
    """Flag: there are points above a place (3,) [m], as in a mug that lies, so that nothing can hold a pusher there."""
    above = points[points[:, 2] > place[2]]
    return bool((np.linalg.norm((above - place)[:, :2], axis=1) < _SPACING).any())


@functools.lru_cache(maxsize=2)  # of a mesh as it is: its hash is that of its vertices and faces
def _points(mesh: trimesh.Trimesh) -> tuple[np.ndarray, np.ndarray]:
    """Points all over a mesh (n, 3) [m], and the normals of their faces (n, 3)."""
    vertices, faces, index = trimesh.remesh.subdivide_to_size(
        mesh.vertices, mesh.faces, _SPACING, max_iter=20, return_index=True
    )
    return vertices[faces].mean(axis=1), mesh.face_normals[index]


def random_push(setup: Setup, X_WO: RigidTransform, generator: np.random.Generator) -> StraightPush:
    """Draws direction and offset of a push through the object.

    Args:
        setup: Object, pusher and its limits.
        X_WO: Pose of the object, at rest.
        generator: Source of randomness.

    Returns:
        The push: level, at the height of `scenario.start`, as fast as lets the object slide on by some 20 mm.

    Raises:
        InputError: A mesh cannot be used.
        ParameterError: The pusher meets no side of the object at that height, or no push stays in the pusher's box.
    """
    limits, theta = setup.scenario.pusher, setup.twin.theta
    mesh_W = load_mesh(setup.twin.mesh_path)
    mesh_W.apply_transform(X_WO.GetAsMatrix4())
    p_WB, shape = mass_properties(mesh_W, mass=1.0).p_com, upright_shape(setup.twin.pusher)
    speed = min(coasting_speed(theta["friction_floor"].value, setup.twin.gravity), limits.max_speed)
    for _ in range(_PUSHES_DRAWN):
        push = choose_push(
            mesh_W,
            p_WB,
            shape,
            generator,
            height=setup.scenario.start.pusher_height,
            speed=speed,
            distance=_DISTANCE,
        )
        ends = np.stack([push.p_WP, push.p_WP + push.distance * push.direction_W])
        if (ends >= limits.low).all() and (ends <= limits.high).all():
            return push
    raise ParameterError(
        f"pusher.low, pusher.high: got {limits.low} and {limits.high} m; allowed: a box with room to push the object "
        f"at {np.round(p_WB, 3).tolist()} m by {_DISTANCE:g} m"
    )


def coasting_speed(
    friction: float, gravity: float, *, distance: float = COASTING, speeds: tuple[float, float] = SPEEDS
) -> float:
    """Speed of a pusher [m/s] after which an object slides on by v^2 / 2 mu g = `distance`.

    Args:
        friction: mu, of object and floor.
        gravity: g, m/s^2.
        distance: m.
        speeds: m/s, lowest and highest; a speed beyond is cut to these.
    """
    return float(np.clip(math.sqrt(2 * max(friction, 0.0) * gravity * distance), *speeds))
