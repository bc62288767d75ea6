# SPDX-License-Identifier: MIT
"""The face on which an object rests, as points that carry its weight.

A flat face presses on the floor everywhere, its corners do not carry the weight alone: a square that is turned on the
spot meets 0.54 times the friction torque that its corners would. `resting_points` replaces the face by a few points
that slide as it does under uniform pressure: they begin in the middles of nearly equal areas, and are moved until
friction force and torque about many centres of rotation agree, with the same share of the weight on each of them.
"""

import functools

import numpy as np
import trimesh
from scipy.cluster.vq import kmeans2
from scipy.optimize import least_squares

from pinwm_drake.geometry.meshes import mass_properties
from pinwm_drake.geometry.pieces import ANYHOW, IF_FLAT, PROTRUSION, UNLESS_FLAT

# A face is flat where its triangles lie this near to the lowest point [m] and are this level (sine of the tilt).
_FLAT, _LEVEL = 2e-4, 0.05
# Faces smaller than this share of the object's footprint (their square of sides) are corners or rims, not faces.
_SMALLEST_SHARE = 0.1
# Of a face with `support: patch`, and of one with `support: faces`.
PATCH_POINTS, FACES_POINTS = 12, 4
_SAMPLES, _CLUSTERED = 20000, 4000
_TRIES = 20
# Centres of rotation, to each side, about which points and face slide; they cover this many times the face's extent.
_CENTRES, _COVER = 9, 1.5
# How strongly the points are held to the middles of the areas, against differences of force and torque by 1.
_HELD = 0.2
# Corners this near to the face's plane [m] belong to its outline.
_CHAMFER = 2e-3
_OUTLINE = 4
# Sides of the convex hull whose planes are as near as this are one side: sine of the angle.
_SAME_SIDE = 1e-3


def resting_points(
    mesh: trimesh.Trimesh, R_WO: np.ndarray, number: int = PATCH_POINTS, *, seed: int = 0
) -> np.ndarray | None:
    """Return the points with which a resting object touches the floor, for uniform pressure on its face.

    The points within the face begin in the middles of nearly equal areas. They are moved until the friction force and
    torque of sliding about each of many centres of rotation are those of the area, as nearly as so many points can.
    They stand out by `PROTRUSION`. The convex hull's other corners follow, and of the face's outline the points that
    are outermost along four directions, on which the object tips.

    Args:
        mesh: Watertight, m, frame O.
        R_WO: (3, 3), orientation at rest; z of W is up.
        number: Points within the face.
        seed: Seed of the sampling of the face.

    Returns:
        (n, 3), m, frame O; None where the object does not rest on a flat face.

    Source: for the torque of uniform pressure, Howe and Cutkosky, "Practical force-motion models for sliding
        manipulation", IJRR 15(6), 1996, section 2.
    """
    up_O = R_WO[2]
    heights = mesh.vertices @ up_O
    lowest = float(heights.min())
    flat = (heights[mesh.faces] < lowest + _FLAT).all(axis=1) & (mesh.face_normals @ up_O < -1.0 + 0.5 * _LEVEL**2)
    area = float(mesh.area_faces[flat].sum())
    footprint = float(np.prod(np.ptp((mesh.vertices @ R_WO.T)[:, :2], axis=0)))
    if area < _SMALLEST_SHARE * footprint:
        return None
    face = trimesh.Trimesh(mesh.vertices, mesh.faces[flat], process=False)
    samples = np.asarray(trimesh.sample.sample_surface(face, _SAMPLES, seed=seed)[0])
    level = samples @ R_WO[:2].T
    points = _match(_even_points(level[:_CLUSTERED], number, np.random.default_rng(seed)), level) @ R_WO[:2]
    points -= np.outer(points @ up_O - lowest + PROTRUSION, up_O)
    corners = np.asarray(trimesh.convex.convex_hull(mesh.vertices).vertices)
    low = corners @ up_O < lowest + _CHAMFER
    outline = corners[low]
    return np.concatenate([points, outline[_outermost(outline, R_WO)], corners[~low]])


def supporting_points(mesh: trimesh.Trimesh, R_WO: np.ndarray, number: int = PATCH_POINTS) -> np.ndarray | None:
    """Return the points with which an object touches the floor, whichever of its flat faces comes to lie on it.

    Each face over which the centre of mass stands has the points of `resting_points`, which count while it is nearly
    on the floor. The convex hull's corners count always, but those of a face's outline that are not outermost: these
    do not while that face lies flat.

    Args:
        mesh: Watertight, m, frame O.
        R_WO: (3, 3), orientation at rest; z of W is up. The face below comes first.
        number: Number of the points within a face.

    Returns:
        (n, 7): point [m, frame O], when it counts (`pieces.ANYHOW`, UNLESS_FLAT or IF_FLAT), and outward normal of its
        face, zeros for ANYHOW; None where the object does not rest on a flat face.
    """
    R_WO = _without_yaw(R_WO)
    if face_points(mesh, R_WO, number) is None:
        return None
    corners = np.asarray(trimesh.convex.convex_hull(mesh.vertices).vertices)
    when, normals = np.full(len(corners), ANYHOW), np.zeros((len(corners), 3))
    always = np.zeros(len(corners), bool)
    rows = []
    others = [normal for normal in resting_normals(mesh) if np.linalg.norm(normal + R_WO[2]) > _SAME_SIDE]
    for R in [np.asarray(R_WO, float), *(turned_down(normal) for normal in others)]:
        own = face_points(mesh, R, number)
        if own is None:
            continue
        rows.append(np.column_stack([own, np.full(len(own), IF_FLAT), np.tile(-R[2], (len(own), 1))]))
        low = np.flatnonzero(corners @ R[2] < float((mesh.vertices @ R[2]).min()) + _CHAMFER)
        always[low[_outermost(corners[low], R)]] = True
        when[low], normals[low] = UNLESS_FLAT, -R[2]
    when[always], normals[always] = ANYHOW, 0.0
    return np.concatenate([*rows, np.column_stack([corners, when, normals])])


def face_points(mesh: trimesh.Trimesh, R_WO: np.ndarray, number: int = PATCH_POINTS) -> np.ndarray | None:
    """Return the points of `resting_points` that are within the face below: they carry the object.

    Args:
        mesh: Watertight, m, frame O.
        R_WO: (3, 3), orientation at rest; z of W is up.
        number: Number of the points.

    Returns:
        (number, 3), m, frame O, standing out by `PROTRUSION`; None where the object does not rest on a flat face.
    """
    found = _face_points(mesh.vertices.tobytes(), mesh.faces.tobytes(), _without_yaw(R_WO).tobytes(), number)
    return None if found is None else found.copy()


def _without_yaw(R_WO: np.ndarray) -> np.ndarray:
    """Return the smallest rotation (3, 3) with the same upward direction in O: a face carries alike at any yaw."""
    x, y, z = np.round(R_WO[2], 12)
    if z < -1.0 + 1e-9:
        return np.diag([1.0, -1.0, -1.0])
    cross = np.array([[0.0, 0.0, -x], [0.0, 0.0, -y], [x, y, 0.0]])
    return np.asarray(np.eye(3) + cross + cross @ cross / (1.0 + z))


@functools.lru_cache(maxsize=256)
def _face_points(vertices: bytes, faces: bytes, rotation: bytes, number: int) -> np.ndarray | None:
    """`face_points` of a mesh in memory: those of one mesh are asked for again and again."""
    mesh = trimesh.Trimesh(
        np.frombuffer(vertices).reshape(-1, 3), np.frombuffer(faces, np.int64).reshape(-1, 3), process=False
    )
    R_WO = np.frombuffer(rotation).reshape(3, 3)
    points = resting_points(mesh, R_WO, number)
    if points is None:
        return None
    return points[points @ R_WO[2] < float((mesh.vertices @ R_WO[2]).min()) - 0.5 * PROTRUSION]


def resting_normals(mesh: trimesh.Trimesh) -> list[np.ndarray]:
    """Outward normals (3,) of the sides of the convex hull over which the centre of mass stands."""
    hull = trimesh.convex.convex_hull(mesh.vertices)
    p_OB = mass_properties(mesh, mass=1.0).p_com
    found: list[np.ndarray] = []
    for triangle, normal in zip(hull.triangles, hull.face_normals, strict=True):
        a, b, c = triangle - p_OB
        # The centre of mass, moved along the normal into the triangle's plane, lies inside of its edges.
        inside = all(np.cross(v - u, -u) @ normal > -1e-9 for u, v in ((a, b), (b, c), (c, a)))
        if inside and not any(np.linalg.norm(normal - other) < _SAME_SIDE for other in found):
            found.append(np.asarray(normal))
    return found


def turned_down(normal: np.ndarray) -> np.ndarray:
    """Rotation (3, 3) after which a side with this outward normal lies on the floor."""
    across = np.cross(normal, np.eye(3)[int(np.argmin(np.abs(normal)))])
    across /= np.linalg.norm(across)
    return np.array([across, np.cross(-normal, across), -normal])


def _even_points(samples: np.ndarray, number: int, generator: np.random.Generator) -> np.ndarray:
    """Return the middles (number, 2) of clusters of samples (n, 2), of the try whose sizes are most equal."""
    best, spread = samples, np.inf
    for _ in range(_TRIES):
        points, owner = kmeans2(samples, number, minit="++", rng=generator)
        found = float(np.bincount(owner, minlength=number).std())
        if found < spread:
            best, spread = points, found
    return best


def _match(points: np.ndarray, samples: np.ndarray) -> np.ndarray:
    """Move points (k, 2) until they slide as the samples (n, 2) of the face do; all in the plane of the floor, m."""
    size = float(np.linalg.norm(samples - samples.mean(axis=0), axis=1).mean())
    low, high = samples.min(axis=0), samples.max(axis=0)
    reach = 0.5 * _COVER * (high - low)
    steps = np.linspace(-1.0, 1.0, _CENTRES)
    centres = 0.5 * (low + high) + np.stack(np.meshgrid(steps, steps), -1).reshape(-1, 2) * reach
    wanted = _sliding(samples, centres, size)

    def difference(flat: np.ndarray) -> np.ndarray:
        here = flat.reshape(-1, 2)
        return np.concatenate(
            [(_sliding(here, centres, size) - wanted).ravel(), _HELD * (here - points).ravel() / size]
        )

    def jacobian(flat: np.ndarray) -> np.ndarray:
        slopes = _sliding_jacobian(flat.reshape(-1, 2), centres, size)
        return np.concatenate([slopes, _HELD * np.eye(flat.size) / size])

    return least_squares(difference, points.ravel(), jacobian, method="lm").x.reshape(-1, 2)


def _sliding(points: np.ndarray, centres: np.ndarray, size: float) -> np.ndarray:
    """Mean friction force (2) and torque (1, over `size`) of points (n, 2) that turn about each centre (m, 2)."""
    unit, distance = _about(points, centres, size)
    return np.concatenate([unit.mean(axis=1), distance.mean(axis=1) / size], axis=-1)


def _sliding_jacobian(points: np.ndarray, centres: np.ndarray, size: float) -> np.ndarray:
    """Derivatives (3 m, 2 n) of `_sliding` about m centres by the coordinates of n points."""
    unit, distance = _about(points, centres, size)
    force = (np.eye(2) - unit[..., :, None] * unit[..., None, :]) / distance[..., None]
    slopes = np.concatenate([np.moveaxis(force, 1, 2), unit[:, None] / size], axis=1)
    return np.asarray(slopes.reshape(3 * len(centres), points.size) / len(points))


def _about(points: np.ndarray, centres: np.ndarray, size: float) -> tuple[np.ndarray, np.ndarray]:
    """Directions (m, n, 2) from centres to points, and distances (m, n, 1) [m], smoothed at the centres."""
    away = points[None] - centres[:, None]
    distance = np.sqrt((away**2).sum(axis=-1, keepdims=True) + (1e-3 * size) ** 2)
    return away / distance, distance


def _outermost(points: np.ndarray, R_WO: np.ndarray) -> np.ndarray:
    """Return indices of the points (n, 3) that are farthest along one of four level directions."""
    angles = 2.0 * np.pi * (np.arange(_OUTLINE) + 0.5) / _OUTLINE
    directions = np.stack([np.cos(angles), np.sin(angles)], -1) @ R_WO[:2]
    return np.unique(np.argmax(points @ directions.T, axis=0))


def corner_spread(mesh: trimesh.Trimesh, R_WO: np.ndarray) -> tuple[float, float, float]:
    """Factors by which the points of `face_points` are to be spread to slide as the corners of the face's outline do.

    They are ratios of root mean squares along the axes of O, about the foot of the centre of mass.

    Args:
        mesh: Watertight, m, frame O.
        R_WO: (3, 3), orientation at rest; z of W is up.

    Returns:
        Along x, y and z; 1 along an axis that the face does not extend in, and where there is no flat face.
    """
    points = face_points(mesh, R_WO)
    if points is None:
        return 1.0, 1.0, 1.0
    hull = np.asarray(trimesh.convex.convex_hull(mesh.vertices).vertices)
    low = hull[hull @ R_WO[2] < float((hull @ R_WO[2]).min()) + _CHAMFER]
    foot = mass_properties(mesh, mass=1.0).p_com
    level = np.eye(3) - np.outer(R_WO[2], R_WO[2])
    wide, even = (np.sqrt((((corners - foot) @ level) ** 2).mean(axis=0)) for corners in (low, points))
    x, y, z = np.where(even > 1e-3 * even.max(), wide / np.maximum(even, 1e-12), 1.0)
    return float(x), float(y), float(z)
