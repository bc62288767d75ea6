# SPDX-License-Identifier: MIT
"""Round and square things: the sphere, capsule, cylinder or box that a mesh is, to within a tolerance.

A cylinder of a file is a prism, and a prism that rolls loses speed on each of its edges. Where the outside of a mesh is
within `TOLERANCE` and `SHARE` of a primitive, physics takes the primitive.

Two convex bodies are compared by their Hausdorff distance. Of the convex hull of the mesh each corner is no farther
from the primitive, and each point of the primitive no farther from the hull.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import permutations
from typing import Literal

import numpy as np
import trimesh
from scipy.optimize import least_squares
from scipy.spatial import ConvexHull, QhullError
from scipy.spatial.transform import Rotation

from pinwm_drake.errors import GeometryError
from pinwm_drake.geometry import shapes
from pinwm_drake.geometry.meshes import outer_mesh
from pinwm_drake.geometry.pieces import HULL, IF_FLAT, ConvexPiece

Kind = Literal["sphere", "capsule", "cylinder", "box"]

# Largest distance: metres, and of the radius; of a box, of half its shortest edge.
TOLERANCE, SHARE = 2e-4, 5e-3
# Share of a side or cap of the primitive that the mesh may leave open: 4 mm square of the side of a mug.
_OPEN = 1e-3
# Points of a primitive whose distance from the hull is found one by one.
_RIM, _NEAREST = 256, 64
# Corners within this many tolerances of a side or cap take part in its fit.
_BAND = 3.0
# Corners farther in than this many tolerances are not on a side.
_CHAMFER = 0.25
# In the first round of a fit, of its smallest size.
_FIRST_BAND = 0.05
_SAME_SIDE = math.cos(math.radians(1.0))
# A side of a box is at least this share of its area; a cylinder with a smaller cap is found by its inertia.
_SMALLEST_SIDE = 0.02
_ROUNDS, _TRIES = 3, 100
_SAME = 1e-9  # m
# A face of a cylinder belongs to an end where its normal is this much along the axis.
_CAP = 0.7
# Points around the side of a cylinder that are looked for on pieces.
_GRID = 256


@dataclass(frozen=True)
class Primitive:
    """A primitive that stands for a mesh, or for some of its pieces.

    Attributes:
        kind: sphere, capsule, cylinder or box.
        size: m. Sphere: radius. Capsule and cylinder: radius, and length of the straight part. Box: its three edges.
        q: wxyz, orientation of its frame G in that of the mesh; z is the axis of a capsule or cylinder.
        p: m, its centre in the frame of the mesh.
        deviation: m, largest distance of the surfaces from each other.
        open_ends: Cylinder: whether its end at -z, and at +z, is open, so that what is inside can be touched there.
    """

    kind: Kind
    size: tuple[float, ...]
    q: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)
    p: tuple[float, float, float] = (0.0, 0.0, 0.0)
    deviation: float = 0.0
    open_ends: tuple[bool, bool] = (False, False)

    @property
    def least(self) -> float:
        """Its radius [m]; of a box half its shortest edge."""
        return 0.5 * min(self.size) if self.kind == "box" else self.size[0]

    @property
    def tolerance(self) -> float:
        """Largest deviation with which it may stand for a mesh [m]."""
        return min(TOLERANCE, SHARE * self.least)

    @property
    def is_mesh(self) -> bool:
        """Flag: it is a box, and the mesh is that very box, which stays what it was."""
        return self.kind == "box" and self.deviation < _SAME

    @property
    def R_OG(self) -> np.ndarray:
        """Orientation (3, 3) of G in the frame O of the mesh."""
        w, x, y, z = self.q
        cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        return np.eye(3) + 2.0 * (w * cross + cross @ cross)

    @property
    def half(self) -> np.ndarray:
        """Extent (3,) m along the axes of G of what is rounded by `radius`: the primitive's core."""
        if self.kind == "box":
            return 0.5 * np.array(self.size)
        return np.array([0.0, 0.0, 0.0 if self.kind == "sphere" else 0.5 * self.size[1]])

    def piece(self) -> ConvexPiece:
        """Convex piece of its shape, frame of the mesh."""
        X_OG = (self.R_OG, np.array(self.p))
        if self.kind == "sphere":
            return shapes.sphere(self.size[0], X_OG[1])
        if self.kind == "box":
            return shapes.box(np.array(self.size), X_OG)
        make = shapes.capsule if self.kind == "capsule" else shapes.cylinder
        piece = make(self.size[0], self.size[1], X_OG)
        return replace(piece, open_ends=self.open_ends)

    def depth(self, points: np.ndarray) -> np.ndarray:
        """Signed distance [m] of points (n, 3), frame of the mesh, from its surface: negative outside."""
        x = np.abs((points - np.array(self.p)) @ self.R_OG)
        if self.kind == "cylinder":
            x = np.column_stack([np.hypot(x[:, 0], x[:, 1]) - self.size[0], x[:, 2] - self.half[2]])
        elif self.kind == "box":
            x = x - self.half
        else:
            return np.asarray(self.size[0] - np.linalg.norm(np.maximum(x - self.half, 0.0), axis=1))
        return np.asarray(-np.linalg.norm(np.maximum(x, 0.0), axis=1) - np.minimum(x.max(axis=1), 0.0))

    def reach(self, directions: np.ndarray) -> np.ndarray:
        """Largest n . x over its points x [m], frame of the mesh, for unit vectors n (n, 3)."""
        n = np.abs(directions @ self.R_OG)
        core = directions @ np.array(self.p) + n @ self.half
        if self.kind == "box":
            return np.asarray(core)
        round_ = np.hypot(n[:, 0], n[:, 1]) if self.kind == "cylinder" else 1.0
        return np.asarray(core + self.size[0] * round_)

    def words(self) -> str:
        """Say what it is, in millimetres."""
        radius, length = f"radius {1e3 * self.size[0]:.2f} mm", f"length {1e3 * self.size[-1]:.2f} mm"
        if self.kind == "box":
            size = " x ".join(f"{1e3 * edge:.2f}" for edge in self.size) + " mm"
        else:
            size = radius if self.kind == "sphere" else f"{radius}, {length}"
        ends = {0: "", 1: ", open at one end", 2: ", open at both ends"}[sum(self.open_ends)]
        return f"a {self.kind} of {size}{ends}, off by {1e3 * self.deviation:.3f} mm at most"


def primitives_of(mesh: trimesh.Trimesh, pieces: Sequence[ConvexPiece]) -> tuple[Primitive, ...]:
    """Find the primitives that stand for a mesh from outside.

    One primitive stands for the whole of it, where its convex hull is one and the mesh covers its surface; the ends of
    a cylinder may be open. Else a cylinder may stand for the pieces that make its side up, as the wall of a mug with a
    handle; and each other piece that is round is its own primitive.

    Args:
        mesh: Closed, m.
        pieces: Its convex pieces, same frame.

    Returns:
        The primitives, frame of the mesh; none where the mesh acts as its pieces.
    """
    try:
        outside = outer_mesh(mesh)
        whole = fit(outside.vertices)
    except (GeometryError, QhullError):
        return ()
    if whole is not None and (covering := _covered(whole, outside)) is not None:
        return (covering,)
    found: list[Primitive] = []
    rest = list(pieces)
    wall = _wall(outside, rest)
    if wall is not None:
        found.append(wall)
        rest = [piece for piece in rest if not _stands_for(wall, piece)]
    if len(pieces) > 1:
        alone = [fit(piece.vertices) for piece in rest if piece.kind == HULL]
        found += [one for one in alone if one is not None and one.kind != "box"]
    return tuple(found)


def acting_pieces(pieces: Sequence[ConvexPiece], primitives: Sequence[Primitive]) -> list[ConvexPiece]:
    """Return pieces with primitives in the place of those that they stand for.

    Those inside a primitive go. Where its ends are open they stay behind it, and count for what is inside.
    """
    rest, result = list(pieces), []
    for primitive in primitives:
        inside = [piece for piece in rest if _stands_for(primitive, piece)]
        if primitive.is_mesh and len(inside) == 1:
            continue
        rest = [piece for piece in rest if not _stands_for(primitive, piece)]
        hidden = inside if any(primitive.open_ends) else []
        result += [replace(primitive.piece(), hides=len(hidden)), *hidden]
    return result + rest


def acting_words(primitives: Sequence[Primitive]) -> str:
    """Say what an object touches as, for one line."""
    return " and ".join(one.words() for one in primitives) or "its mesh"


def acting_mesh(mesh: trimesh.Trimesh, primitives: Sequence[Primitive]) -> trimesh.Trimesh:
    """Return the mesh whose flat faces a floor meets: that of a box which stands for all of it, else the mesh."""
    if len(primitives) == 1 and primitives[0].kind == "box" and not primitives[0].is_mesh:
        hull = primitives[0].piece()
        return trimesh.convex.convex_hull(hull.vertices)
    return mesh


def acting_points(points: np.ndarray, primitives: Sequence[Primitive]) -> np.ndarray:
    """Points of `patch.supporting_points` (n, 7) without the corners on round primitives, which have their own."""
    kept = points[:, 3] == IF_FLAT
    round_ = [one for one in primitives if one.kind != "box"]
    apart = [np.abs(one.depth(points[:, :3])) > _BAND * one.tolerance for one in round_]
    return np.asarray(points[kept | np.all(apart, axis=0)])


def fit(points: np.ndarray) -> Primitive | None:
    """Fit the primitive whose surface is that of the convex hull of points (n, 3) m, within its tolerance; or None.

    Several are: the one that is nearest.

    Raises:
        QhullError: The points lie in a plane.
    """
    hull = trimesh.convex.convex_hull(np.asarray(points, float))
    sides = _sides(hull)
    found = [_fitted("sphere", hull, np.eye(3))]
    for axis in _axes(hull, sides):
        R = _about(axis)
        found += [_fitted("cylinder", hull, R), _fitted("capsule", hull, R)]
    if len(sides):
        across = sides[np.abs(sides @ sides[0]) < 0.05]
        if len(across):
            x, y = sides[0], across[0] - (across[0] @ sides[0]) * sides[0]
            y /= np.linalg.norm(y)
            found.append(_fitted("box", hull, np.column_stack([x, y, np.cross(x, y)])))
    fits = [one for one in found if one is not None and one.deviation <= one.tolerance]
    return min(fits, key=lambda one: one.deviation, default=None)


def deviation(primitive: Primitive, hull: trimesh.Trimesh) -> float:
    """Hausdorff distance [m] of a primitive and a convex hull."""
    most = _plain_deviation(primitive, hull)
    points = _extreme_points(primitive, hull)
    if most > primitive.tolerance or not len(points):
        return most
    if primitive.kind == "capsule":  # directions across the axis, out of edges, there given as unit vectors
        return max(most, float((primitive.reach(points) - (points @ hull.vertices.T).max(axis=1)).max()))
    over = (points @ hull.face_normals.T - face_levels(hull)).max(axis=1)
    points = points[np.argsort(-over)[:_NEAREST]]
    # In millimetres, as trimesh takes small triangles for lines.
    faces = np.tile(1e3 * hull.triangles, (len(points), 1, 1))
    near = 1e-3 * trimesh.triangles.closest_point(faces, np.repeat(1e3 * points, len(hull.triangles), axis=0))
    apart = np.linalg.norm(near.reshape(len(points), -1, 3) - points[:, None], axis=2).min(axis=1)
    return max(most, float(apart[np.sort(over)[::-1][:_NEAREST] > 0.0].max(initial=0.0)))


def _plain_deviation(primitive: Primitive, hull: trimesh.Trimesh) -> float:
    """How far corners of a hull are from a primitive, and the primitive stands out over faces of the hull [m]."""
    over = primitive.reach(hull.face_normals) - face_levels(hull)
    return max(float(-primitive.depth(hull.vertices).min()), float(over.max()))


def face_levels(hull: trimesh.Trimesh) -> np.ndarray:
    """Distance (n,) m of the faces of a hull from the origin, along their normals."""
    return np.asarray(np.einsum("fi,fi->f", hull.face_normals, hull.triangles[:, 0]))


def _extreme_points(primitive: Primitive, hull: trimesh.Trimesh) -> np.ndarray:
    """Points of a primitive that are farthest from a hull, if not over one of its faces.

    Corners of a box; points of the rims of a cylinder, those between the hull's corners among them. Of a capsule,
    directions across its axis, out of the edges of the hull over which the axis changes sides.
    """
    G = primitive.R_OG
    if primitive.kind == "sphere":
        return np.zeros((0, 3))
    if primitive.kind == "box":
        signs = np.array([[i, j, k] for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)])
        return np.asarray(np.array(primitive.p) + signs * primitive.half @ G.T)
    if primitive.kind == "capsule":
        pairs = hull.face_normals[hull.face_adjacency]
        along = pairs @ G[:, 2]
        crossing = along[:, 0] * along[:, 1] < 0.0
        pairs, along = pairs[crossing], np.abs(along[crossing])
        across = pairs[:, 0] * along[:, 1:] + pairs[:, 1] * along[:, :1]
        return np.asarray(across / np.linalg.norm(across, axis=1, keepdims=True))
    x = (hull.vertices - np.array(primitive.p)) @ G
    own = np.sort(np.arctan2(x[:, 1], x[:, 0]))
    own = 0.5 * (own + np.append(own[1:], own[0] + 2.0 * np.pi))
    angles = np.concatenate([own, 2.0 * np.pi * np.arange(_RIM) / _RIM])
    rim = primitive.size[0] * np.column_stack([np.cos(angles), np.sin(angles), np.zeros(len(angles))])
    return np.concatenate([np.array(primitive.p) + (rim + sign * primitive.half) @ G.T for sign in (-1, 1)])


def _sides(hull: trimesh.Trimesh) -> np.ndarray:
    """Return outward normals (n, 3) of the flat sides of a hull, the largest first."""
    order = np.argsort(-hull.area_faces)[:2000]
    normals, areas = hull.face_normals[order], hull.area_faces[order]
    free, found = np.ones(len(order), bool), []
    for k in range(min(len(order), 64)):
        if free[k]:
            mine = free & (normals @ normals[k] > _SAME_SIDE)
            free[mine] = False
            found.append((float(areas[mine].sum()), areas[mine] @ normals[mine]))
    large = [(area, n) for area, n in sorted(found, key=lambda one: -one[0]) if area > _SMALLEST_SIDE * hull.area]
    return np.array([n / np.linalg.norm(n) for _, n in large]).reshape(-1, 3)


def _axes(hull: trimesh.Trimesh, sides: np.ndarray) -> list[np.ndarray]:
    """Return axes about which a hull may be round: of its inertia, of the normals of its faces, of its largest side.

    Inertia is the same about all axes where a cylinder is 1.73 radii long, and the normals where it is 2.
    """
    _, inertia = np.linalg.eigh(hull.moment_inertia)
    _, gauss = np.linalg.eigh((hull.face_normals * hull.area_faces[:, None]).T @ hull.face_normals)
    found: list[np.ndarray] = []
    for axis in [*sides[:1], *inertia.T, *gauss.T]:
        if all(abs(axis @ other) < _SAME_SIDE for other in found):
            found.append(axis)
    return found


def _about(axis: np.ndarray) -> np.ndarray:
    """Rotation (3, 3) whose third column is an axis, turned to the side of its largest component."""
    z = axis * np.sign(axis[int(np.argmax(np.abs(axis)))]) / np.linalg.norm(axis)
    x = np.cross(np.roll(np.eye(3)[int(np.argmax(np.abs(z)))], -1), z)
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(z, x), z])


def _fitted(kind: Kind, hull: trimesh.Trimesh, R: np.ndarray) -> Primitive | None:
    """Fit a primitive by least squares to the corners of a hull, from axes R (3, 3) on; None where that cannot be."""
    x = hull.vertices @ R
    p = R @ (0.5 * (x.min(axis=0) + x.max(axis=0)))
    span = np.ptp(x, axis=0)
    size = span
    if kind in ("cylinder", "capsule"):
        center, radius = _circle(x[:, :2])
        p = R @ np.append(center, p @ R[:, 2])
        size = np.array([radius, span[2] - (2.0 * radius if kind == "capsule" else 0.0)])
    elif kind == "sphere":
        p = np.asarray(hull.center_mass)
        size = np.linalg.norm(hull.vertices - p, axis=1).mean(keepdims=True)
    for number in range(_ROUNDS):
        if not np.isfinite(size).all() or min(size) <= 0.0:
            return None
        now = _primitive(kind, size, R, p)
        band = _BAND * now.tolerance if number else _FIRST_BAND * now.least
        if _plain_deviation(now, hull) > band:
            return None
        off = _residuals(kind, size, (hull.vertices - p) @ R)
        places = np.abs(off) < band
        if number:  # corners of a chamfer belong to one side
            places &= off > off.max(axis=1, keepdims=True) - _CHAMFER * now.tolerance

        def differences(step: np.ndarray, now=(R, p, size), places=places) -> np.ndarray:
            R, p, size = now
            here = (hull.vertices - p - step[3:6]) @ R @ Rotation.from_rotvec(step[:3]).as_matrix()
            return np.append(_residuals(kind, size + step[6:], here)[places], 1e-6 * step)

        found = least_squares(differences, np.zeros(6 + len(size)), method="lm", xtol=1e-9, max_nfev=_TRIES).x
        R, p, size = R @ Rotation.from_rotvec(found[:3]).as_matrix(), p + found[3:6], size + found[6:]
    if not np.isfinite(size).all() or min(size) <= 0.0:
        return None
    if kind == "box":
        R, size = _in_order(R, size)
    elif kind != "sphere":
        R = _about(R[:, 2])
    result = _primitive(kind, size.round(9), np.eye(3) if kind == "sphere" else R, p.round(9))
    return replace(result, deviation=deviation(result, hull))


def _in_order(R: np.ndarray, size: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Axes (3, 3) and edges (3,) of a box in the order in which it is turned least."""
    order = max(map(list, permutations(range(3))), key=lambda k: float(np.abs(R[:, k].diagonal()).sum()))
    R = R[:, order] * np.where(R[:, order].diagonal() < 0.0, -1.0, 1.0)
    R[:, int(np.abs(R.diagonal()).argmin())] *= np.sign(np.linalg.det(R))
    return R, size[order]


def _primitive(kind: Kind, size: np.ndarray, R: np.ndarray, p: np.ndarray) -> Primitive:
    w, x, y, z = (Rotation.from_matrix(R).as_quat(canonical=True, scalar_first=True).round(12) + 0.0).tolist()
    return Primitive(kind, tuple(size.tolist()), (w, x, y, z), (float(p[0]), float(p[1]), float(p[2])))


def _residuals(kind: Kind, size: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Distances (n, k) m of points (n, 3), frame G, from the k parts of a surface, positive outside."""
    if kind == "box":
        return np.asarray(np.abs(x) - 0.5 * size)
    z = np.abs(x[:, 2:])
    if kind == "cylinder":
        return np.hstack([np.hypot(x[:, :1], x[:, 1:2]) - size[0], z - 0.5 * size[1]])
    core = np.maximum(z - 0.5 * size[1], 0.0) if kind == "capsule" else z
    return np.asarray(np.linalg.norm(np.hstack([x[:, :2], core]), axis=1, keepdims=True) - size[0])


def _circle(points: np.ndarray) -> tuple[np.ndarray, float]:
    """Centre (2,) and radius of the circle through the outline of points (n, 2), by least squares."""
    outline = points[ConvexHull(points).vertices]
    middle = outline.mean(axis=0)
    x = outline - middle
    center = np.linalg.lstsq(2.0 * (x - x.mean(axis=0)), (x**2).sum(axis=1) - (x**2).sum(axis=1).mean(), rcond=None)[0]
    return middle + center, float(np.linalg.norm(x - center, axis=1).mean())


def _covered(primitive: Primitive, mesh: trimesh.Trimesh) -> Primitive | None:
    """Return a primitive with its open ends; None where a mesh covers its surface nowhere near as its hull does."""
    own, whole = _areas(primitive, mesh), _areas(primitive, trimesh.convex.convex_hull(mesh.vertices))
    closed = own > (1.0 - _OPEN) * whole
    if not closed[0]:
        return None
    if primitive.kind != "cylinder":
        return primitive
    return replace(primitive, open_ends=(not closed[1], not closed[2]))


def _areas(primitive: Primitive, mesh: trimesh.Trimesh) -> np.ndarray:
    """Area (3,) m^2 of the faces of a mesh on a primitive: of a cylinder on its side, its end at -z and at +z."""
    places = np.concatenate([mesh.triangles, mesh.triangles.mean(axis=1, keepdims=True)], axis=1)
    depth = primitive.depth(places.reshape(-1, 3)).reshape(-1, 4)
    on = (np.abs(depth) < 1.01 * primitive.tolerance).all(axis=1)
    # Turned out of the primitive, as the faces of a cavity near its surface are not.
    on &= np.einsum("fi,fi->f", mesh.face_normals, places[:, 3] - np.array(primitive.p)) > 0.0
    along = mesh.face_normals @ primitive.R_OG[:, 2] if primitive.kind == "cylinder" else np.zeros(len(on))
    parts = [np.abs(along) <= _CAP, along < -_CAP, along > _CAP]
    return np.array([float(mesh.area_faces[on & part].sum()) for part in parts])


def _wall(mesh: trimesh.Trimesh, pieces: Sequence[ConvexPiece]) -> Primitive | None:
    """Return the cylinder whose side some of the pieces of a mesh make up; None where there is none."""
    hull = trimesh.convex.convex_hull(mesh.vertices)
    for axis in _axes(hull, _sides(hull)):
        R = _about(axis)
        level = np.abs(hull.face_normals @ axis) < 0.05
        center, radius = _most_round((hull.triangles_center @ R)[level], (hull.face_normals @ R)[level])
        if not 0.0 < radius < hull.scale:
            continue
        reach = radius + _FIRST_BAND * radius
        inside = [one for one in pieces if np.linalg.norm((one.vertices @ R)[:, :2] - center, axis=1).max() < reach]
        if not inside or len(inside) == len(pieces):
            continue
        corners = np.concatenate([piece.vertices for piece in inside])
        found = fit(corners) or _without_outstanding(corners)
        if found is None or found.kind != "cylinder" or not _side_is_of(found, inside):
            continue
        own = _areas(found, mesh)
        whole = _areas(found, trimesh.convex.convex_hull(corners[found.depth(corners) > -_BAND * found.tolerance]))
        closed = own > (1.0 - _OPEN) * whole
        return replace(found, open_ends=(not closed[1], not closed[2]))
    return None


def _without_outstanding(corners: np.ndarray) -> Primitive | None:
    """Primitive of the corners (n, 3) of a wall without those that stand out of it, as of a handle's root; or None."""
    hull = trimesh.convex.convex_hull(corners)
    found = [_fitted("cylinder", hull, _about(axis)) for axis in _axes(hull, _sides(hull))]
    rough = min((one for one in found if one is not None), key=lambda one: one.deviation, default=None)
    try:
        return None if rough is None else fit(corners[rough.depth(corners) > -rough.tolerance])
    except QhullError:  # what is left lies in a plane
        return None


def _most_round(points: np.ndarray, normals: np.ndarray) -> tuple[np.ndarray, float]:
    """Centre (2,) and radius of the circle from which most faces (n, 2 or 3) with these normals stand out."""
    if len(points) < 3:
        return np.zeros(2), 0.0
    rows = np.concatenate([np.column_stack([np.tile(np.eye(2)[k], (len(points), 1)), normals[:, k]]) for k in (0, 1)])
    right, weights = points[:, :2].T.ravel(), np.ones(len(points))
    for _ in range(30):
        root = np.sqrt(np.tile(weights, 2))
        x = np.linalg.lstsq(rows * root[:, None], right * root, rcond=None)[0]
        off = np.linalg.norm((rows @ x - right).reshape(2, -1), axis=0)
        weights = 1.0 / np.maximum(off, 1e-6)
    return x[:2], float(x[2])


def _side_is_of(primitive: Primitive, pieces: Sequence[ConvexPiece]) -> bool:
    """Flag: each of a grid of points on the side of a cylinder is on one of the pieces, to within the tolerance."""
    angles, heights = np.meshgrid(2.0 * np.pi * np.arange(_GRID) / _GRID, np.linspace(-1.0, 1.0, _GRID // 4))
    ring = primitive.size[0] * np.stack([np.cos(angles), np.sin(angles)], -1).reshape(-1, 2)
    points = np.column_stack([ring, heights.ravel() * primitive.half[2]]) @ primitive.R_OG.T + np.array(primitive.p)
    missed = np.ones(len(points), bool)
    for piece in pieces:
        hull = trimesh.convex.convex_hull(piece.vertices)
        out = (points[missed] @ hull.face_normals.T - face_levels(hull)).max(axis=1)
        missed[missed] = out > 1.01 * primitive.tolerance
    return not missed.any()


def _stands_for(primitive: Primitive, piece: ConvexPiece) -> bool:
    """Flag: a hull is within a primitive, to its tolerance."""
    return piece.kind == HULL and bool(primitive.depth(piece.vertices).min() > -_BAND * primitive.tolerance)
