# SPDX-License-Identifier: MIT
"""Factories of convex pieces: sphere, capsule, cylinder, box, convex hull.

Each returns the piece in the body frame B. It raises GeometryError where a length is not positive, a point is not
finite, or a pose is none.
"""

import numpy as np

from pinwm_drake.errors import GeometryError
from pinwm_drake.geometry.pieces import CAPSULE, CYLINDER, HULL, SPHERE, ConvexPiece

# Loops of a box whose vertex (i, j, k) in {0, 1}^3 has the index 4 i + 2 j + k: -x, +x, -y, +y, -z, +z.
_BOX_FACES = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))

Pose = tuple[np.ndarray, np.ndarray]


def sphere(radius: float, p_BG: np.ndarray | None = None) -> ConvexPiece:
    """Ball about a point of the body.

    Args:
        radius: m.
        p_BG: (3,), m, frame B. Its centre; the origin of B when not given.
    """
    _positive("radius of a sphere", radius)
    centre = np.zeros(3) if p_BG is None else _vector("p_BG of a sphere", p_BG)
    return ConvexPiece(SPHERE, centre.reshape(1, 3), float(radius))


def capsule(radius: float, length: float, X_BG: Pose | None = None) -> ConvexPiece:
    """Return a cylinder about z of frame G, centred in G, with a half ball on each end.

    Args:
        radius: m.
        length: m. Of the cylindrical part: the capsule is `length + 2 radius` long.
        X_BG: (R (3, 3), p (3,) m): pose of G in B; identity when not given.
    """
    return _stick(CAPSULE, "capsule", radius, length, X_BG)


def cylinder(radius: float, length: float, X_BG: Pose | None = None) -> ConvexPiece:
    """Return a cylinder about z of frame G, centred in G, with flat caps and sharp rims.

    Args:
        radius: m.
        length: m.
        X_BG: (R (3, 3), p (3,) m): pose of G in B; identity when not given.
    """
    return _stick(CYLINDER, "cylinder", radius, length, X_BG)


def box(size: np.ndarray, X_BG: Pose | None = None) -> ConvexPiece:
    """Return a box centred in frame G, as a hull with six faces.

    Args:
        size: (3,), m. Full edge lengths along x, y and z of G.
        X_BG: (R (3, 3), p (3,) m): pose of G in B; identity when not given.
    """
    edges = _vector("size of a box", size)
    for edge in edges:
        _positive("edge length of a box", edge)
    signs = np.array([[i, j, k] for i in (-0.5, 0.5) for j in (-0.5, 0.5) for k in (-0.5, 0.5)])
    R_BG, p_BG = _pose(X_BG)
    return ConvexPiece(HULL, signs * edges @ R_BG.T + p_BG, 0.0, _BOX_FACES)


def convex_hull(points: np.ndarray, merge_tolerance: float = 1e-6) -> ConvexPiece:
    """Return the convex hull of points, with coplanar triangles merged into one face.

    Args:
        points: (n, 3), m, frame B.
        merge_tolerance: Triangles whose corners lie within this fraction of the hull's extent of one plane
            become one face. A file that rounds its coordinates to 1e-6 m wants about 1e-6 m over the extent.

    Returns:
        The piece, in B. Only points that are corners of the hull remain, in their given order.

    Raises:
        GeometryError: Fewer than four points, a point that is not finite, or points in one plane.
    """
    from scipy.spatial import ConvexHull, QhullError

    cloud = np.asarray(points, float)
    if cloud.ndim != 2 or cloud.shape[1] != 3 or len(cloud) < 4:
        raise GeometryError(f"convex_hull got points of shape {cloud.shape}; allowed: (n, 3) with n of 4 or more")
    if not np.all(np.isfinite(cloud)):
        raise GeometryError("convex_hull got a point that is not finite; allowed: finite coordinates in metres")
    try:
        hull = ConvexHull(cloud)
    except QhullError as error:
        raise GeometryError(f"convex_hull of {len(cloud)} points failed: they must not lie in one plane") from error
    loops = _merge_triangles(
        cloud, hull.simplices, hull.equations, merge_tolerance * float(np.ptp(cloud, axis=0).max())
    )
    # A corner has three faces or more; a vertex of only two lies within the tolerance on the edge between
    # them.
    while True:
        valence = np.bincount(np.concatenate([np.array(loop) for loop in loops]), minlength=len(cloud))
        if not np.any((valence > 0) & (valence < 3)):
            break
        loops = [tuple(v for v in loop if valence[v] >= 3) for loop in loops]
        loops = [loop for loop in loops if len(loop) >= 3]
    kept = np.flatnonzero(valence)
    new_index = {int(old): new for new, old in enumerate(kept)}
    faces = tuple(tuple(new_index[v] for v in loop) for loop in loops)
    return ConvexPiece(HULL, np.ascontiguousarray(cloud[kept]), 0.0, faces)


def _merge_triangles(
    points: np.ndarray, triangles: np.ndarray, planes: np.ndarray, tolerance: float
) -> list[tuple[int, ...]]:
    """Join triangles of a hull that lie in one plane, the largest first; the loops of the joined faces."""
    corners = points[triangles]
    crosses = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    inward = np.sum(crosses * planes[:, :3], axis=1) < 0.0
    triangles = np.where(inward[:, None], triangles[:, ::-1], triangles)
    triangle_of = {(int(t[k]), int(t[(k + 1) % 3])): number for number, t in enumerate(triangles) for k in range(3)}
    areas = np.linalg.norm(crosses, axis=1)
    owner = np.full(len(triangles), -1)
    loops = []
    for seed in np.argsort(-areas, kind="stable"):
        if owner[seed] >= 0:
            continue
        owner[seed] = seed
        stack, members = [int(seed)], []
        while stack:
            member = stack.pop()
            members.append(member)
            for k in range(3):
                twin = triangle_of.get((int(triangles[member][(k + 1) % 3]), int(triangles[member][k])))
                if twin is None:
                    raise GeometryError("convex_hull could not close its faces; remove points that nearly coincide")
                heights = points[triangles[twin]] @ planes[seed, :3] + planes[seed, 3]
                if owner[twin] < 0 and np.max(np.abs(heights)) <= tolerance:
                    owner[twin] = seed
                    stack.append(twin)
        rim = {
            a: b
            for member in members
            for a, b in ((int(triangles[member][k]), int(triangles[member][(k + 1) % 3])) for k in range(3))
            if owner[triangle_of[(b, a)]] != seed
        }
        if not rim:
            raise GeometryError(f"convex_hull of {len(points)} points is flat to {tolerance:g} m; allowed: a solid")
        start = min(rim)
        loop, vertex = [start], rim[start]
        while vertex != start:
            loop.append(vertex)
            vertex = rim[vertex]
        loops.append(tuple(loop))
    return loops


def _positive(what: str, value: float) -> None:
    if not (isinstance(value, (int, float, np.floating, np.integer)) and np.isfinite(value) and value > 0.0):
        raise GeometryError(f"{what} is {value}; allowed: a positive length in metres")


def _vector(what: str, value: np.ndarray) -> np.ndarray:
    try:
        vector = np.asarray(value, float)
    except (TypeError, ValueError):
        vector = np.empty(0)
    if vector.shape != (3,) or not np.all(np.isfinite(vector)):
        raise GeometryError(f"{what} is {value}; allowed: three finite numbers in metres")
    return vector


def _pose(X_BG: Pose | None) -> Pose:
    if X_BG is None:
        return np.eye(3), np.zeros(3)
    R_BG, p_BG = np.asarray(X_BG[0], float), _vector("position in X_BG", X_BG[1])
    if R_BG.shape != (3, 3) or np.max(np.abs(R_BG @ R_BG.T - np.eye(3))) > 1e-9 or np.linalg.det(R_BG) < 0.0:
        raise GeometryError(f"rotation in X_BG is {R_BG.tolist()}; allowed: a rotation matrix to 1e-9")
    return R_BG, p_BG


def _stick(kind: int, name: str, radius: float, length: float, X_BG: Pose | None) -> ConvexPiece:
    _positive(f"radius of a {name}", radius)
    _positive(f"length of a {name}", length)
    R_BG, p_BG = _pose(X_BG)
    ends = np.array([p_BG - 0.5 * length * R_BG[:, 2], p_BG + 0.5 * length * R_BG[:, 2]])
    return ConvexPiece(kind, ends, float(radius))
