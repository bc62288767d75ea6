# SPDX-License-Identifier: MIT
"""Independent signed distances of convex pieces: a Minkowski difference by qhull, and Drake's SceneGraph."""

import numpy as np
from pydrake.common import MemoryFile
from pydrake.geometry import (
    Box,
    Capsule,
    Convex,
    Cylinder,
    FramePoseVector,
    GeometryFrame,
    GeometryInstance,
    InMemoryMesh,
    ProximityProperties,
    SceneGraph,
    Sphere,
)
from pydrake.math import RigidTransform, RotationMatrix
from scipy.optimize import minimize
from scipy.spatial import ConvexHull

from pinwm_drake.geometry.entry import collide_bodies, contact_from_features
from pinwm_drake.geometry.pieces import CAPSULE, HULL, SPHERE, ConvexPiece, PieceTable


def random_rotation(generator: np.random.Generator) -> np.ndarray:
    q = generator.normal(size=4)
    w, x, y, z = q / np.linalg.norm(q)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def contacts(table: PieceTable, X_WA, X_WB, margin: float, body_A: int = 0, body_B: int = 1) -> list[dict]:
    """The narrow phase's rows with gap, normal and points in the world frame."""
    rows = np.zeros((64, 16))
    count = collide_bodies(table, body_A, *X_WA, body_B, *X_WB, margin, rows, 0)
    return [evaluate(rows[k], X_WA, X_WB) for k in range(count)]


def evaluate(row: np.ndarray, X_WA, X_WB) -> dict:
    n, a, b = np.zeros(3), np.zeros(3), np.zeros(3)
    phi = contact_from_features(row, *X_WA, *X_WB, n, a, b)
    return {"phi": phi, "n": n, "a": a, "b": b, "kinds": (int(row[0]), int(row[8])), "row": row.copy()}


def minkowski_distance(one: ConvexPiece, X_1, two: ConvexPiece, X_2) -> tuple[float, np.ndarray]:
    """Signed distance of two pieces without cylinders, and the normal from `two` to `one`.

    The cores' difference is a polytope; in penetration the distance is that to its nearest face plane,
    outside that to the nearest triangle. Exact up to qhull's rounding.
    """
    p = one.vertices @ X_1[0].T + X_1[1]
    q = two.vertices @ X_2[0].T + X_2[1]
    difference = (p[:, None] - q[None]).reshape(-1, 3)
    if len(difference) >= 4 and np.linalg.matrix_rank(difference - difference[0], tol=1e-9) == 3:
        hull = ConvexHull(difference)
        offsets = hull.equations[:, 3]
        if np.all(offsets <= 0.0):
            k = int(np.argmax(offsets))
            return offsets[k] - one.radius - two.radius, -hull.equations[k, :3]
        triangles = difference[hull.simplices[offsets > 0.0]]
    elif len(difference) == 1:
        triangles = np.repeat(difference[None], 3, axis=1)
    elif len(difference) == 2:
        triangles = difference[[0, 1, 1]][None]
    else:
        triangles = difference[np.array([[0, 1, 3], [0, 3, 2]])]
    nearest = np.array([_nearest_to_origin(triangle) for triangle in triangles])
    distances = np.linalg.norm(nearest, axis=1)
    k = int(np.argmin(distances))
    return distances[k] - one.radius - two.radius, nearest[k] / distances[k]


def _nearest_to_origin(triangle: np.ndarray) -> np.ndarray:
    a, b, c = triangle
    normal = np.cross(b - a, c - a)
    if np.linalg.norm(normal) > 1e-14:
        foot = normal * (a @ normal) / (normal @ normal)
        inside = [np.cross(v - u, foot - u) @ normal >= 0.0 for u, v in ((a, b), (b, c), (c, a))]
        if all(inside):
            return foot
    best = a
    for u, v in ((a, b), (b, c), (c, a)):
        span = v - u
        t = np.clip(-(u @ span) / max(span @ span, 1e-300), 0.0, 1.0)
        if np.linalg.norm(u + t * span) < np.linalg.norm(best):
            best = u + t * span
    return best


def support_distance(one: ConvexPiece, X_1, two: ConvexPiece, X_2) -> float:
    """Signed distance of any two pieces: the largest separation over all directions.

    Any direction gives a lower bound. The search takes 5000 directions and refines the best ones of different
    regions by Nelder and Mead's method in the tangent plane, restarted, since the separation has kinks.
    """
    directions = _DIRECTIONS
    values = separations(one, X_1, two, X_2, directions)
    starts: list[np.ndarray] = []
    for k in np.argsort(-values):
        if all(directions[k] @ other < 0.99 for other in starts):
            starts.append(directions[k])
        if len(starts) == 4:
            break
    best = -np.inf
    for centre in starts:
        width = 0.03
        for _ in range(3):
            first = np.cross(centre, np.eye(3)[np.argmin(np.abs(centre))])
            first /= np.linalg.norm(first)
            basis = np.stack([first, np.cross(centre, first)])

            def negative(c, centre=centre, basis=basis):
                n = centre + c @ basis
                return -separations(one, X_1, two, X_2, (n / np.linalg.norm(n))[None])[0]

            simplex = width * np.array([[0.0, 0.0], [1.0, 0.2], [-0.3, 1.0]])
            found = minimize(
                negative,
                np.zeros(2),
                method="Nelder-Mead",
                options={"initial_simplex": simplex, "xatol": 1e-10, "fatol": 1e-14, "maxiter": 200},
            )
            centre = centre + found.x @ basis
            centre /= np.linalg.norm(centre)
            best = max(best, -found.fun)
            width *= 0.1
    return float(best)


def best_sampled_separation(one: ConvexPiece, X_1, two: ConvexPiece, X_2) -> float:
    """The largest separation over 5000 directions, a lower bound of the signed distance."""
    return float(np.max(separations(one, X_1, two, X_2, _DIRECTIONS)))


def _fibonacci_sphere(number: int) -> np.ndarray:
    k = np.arange(number) + 0.5
    z, angle = 1.0 - 2.0 * k / number, np.pi * (1.0 + np.sqrt(5.0)) * k
    return np.stack([np.sqrt(1 - z * z) * np.cos(angle), np.sqrt(1 - z * z) * np.sin(angle), z], axis=1)


_DIRECTIONS = _fibonacci_sphere(5000)


def separations(one: ConvexPiece, X_1, two: ConvexPiece, X_2, directions: np.ndarray) -> np.ndarray:
    """Separation of two pieces along unit directions (N, 3) from `two` to `one`, m."""
    return -_supports(one, X_1, -directions) - _supports(two, X_2, directions)


def _supports(piece: ConvexPiece, X, directions: np.ndarray) -> np.ndarray:
    points = piece.vertices @ X[0].T + X[1]
    reach = np.max(directions @ points.T, axis=1)
    if piece.kind in (SPHERE, CAPSULE):
        return reach + piece.radius
    if piece.kind == HULL:
        return reach
    axis = points[1] - points[0]
    axis /= np.linalg.norm(axis)
    # Not sqrt(1 - cos^2), which loses half of the digits along the axis.
    across = directions - np.outer(directions @ axis, axis)
    return reach + piece.radius * np.linalg.norm(across, axis=1)


class DrakePair:
    """Signed distance of two pieces by Drake's QueryObject."""

    def __init__(self, one: ConvexPiece, two: ConvexPiece) -> None:
        self.scene_graph = SceneGraph()
        source = self.scene_graph.RegisterSource("pair")
        self.frames, self.geometries, offsets = [], [], []
        for name, piece in (("one", one), ("two", two)):
            frame = self.scene_graph.RegisterFrame(source, GeometryFrame(name))
            shape, X_BG = drake_shape(piece)
            instance = GeometryInstance(X_BG, shape, name)
            instance.set_proximity_properties(ProximityProperties())
            self.frames.append(frame)
            self.geometries.append(self.scene_graph.RegisterGeometry(source, frame, instance))
            offsets.append(X_BG)
        self.context = self.scene_graph.CreateDefaultContext()
        self.port = self.scene_graph.get_source_pose_port(source)

    def distance(self, X_1, X_2) -> tuple[float, np.ndarray]:
        """Signed distance [m] and the normal from `two` to `one` in the world frame."""
        poses = FramePoseVector()
        for frame, (R, p) in zip(self.frames, (X_1, X_2), strict=True):
            poses.set_value(frame, RigidTransform(RotationMatrix(R), p))
        self.port.FixValue(self.context, poses)
        query = self.scene_graph.get_query_output_port().Eval(self.context)
        pair = query.ComputeSignedDistancePairClosestPoints(*self.geometries)
        return pair.distance, np.array(pair.nhat_BA_W)


def drake_shape(piece: ConvexPiece) -> tuple[object, RigidTransform]:
    if piece.kind == SPHERE:
        return Sphere(piece.radius), RigidTransform(piece.vertices[0])
    if piece.kind == HULL:
        size = np.ptp(piece.vertices, axis=0)
        corners = {tuple(c) for c in np.round((piece.vertices - piece.vertices.min(axis=0)) / size, 9)}
        if len(piece.vertices) == 8 and corners == {(i, j, k) for i in (0, 1) for j in (0, 1) for k in (0, 1)}:
            return Box(size), RigidTransform(0.5 * (piece.vertices.min(axis=0) + piece.vertices.max(axis=0)))
        lines = [f"v {x:.17g} {y:.17g} {z:.17g}" for x, y, z in piece.vertices]
        lines += ["f " + " ".join(str(v + 1) for v in face) for face in piece.faces]
        contents = MemoryFile(contents="\n".join(lines), extension=".obj", filename_hint="hull.obj")
        return Convex(mesh_data=InMemoryMesh(mesh_file=contents), scale=1.0), RigidTransform()
    span = piece.vertices[1] - piece.vertices[0]
    length = float(np.linalg.norm(span))
    pose = RigidTransform(
        RotationMatrix.MakeFromOneVector(span / length, 2), 0.5 * (piece.vertices[0] + piece.vertices[1])
    )
    shape = Capsule if piece.kind == CAPSULE else Cylinder
    return shape(piece.radius, length), pose
