# SPDX-License-Identifier: MIT
"""Convex pieces of a body, and the flat table of numbers in which the compiled narrow phase reads them."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise, zip_longest
from typing import NamedTuple

import numpy as np

from pinwm_drake.errors import GeometryError

SPHERE = 0
CAPSULE = 1
HULL = 2
CYLINDER = 3

# A standing cylinder touches the floor with this many points fixed in each rim.
RIM_POINTS = 8
# A rim that is tilted against the floor is a regular polygon with so many corners, of which the fixed points are some.
RIM_CORNERS = 64

# More floor contacts of a body than this are reduced to the outermost ones.
MAX_FLOOR_POINTS = 16

# When a point that belongs to no rim can touch the floor: always; unless its face lies on the floor, which has others
# to carry it; only while that face is nearly on it; or only while the axis of its round piece is nearly level.
ANYHOW, UNLESS_FLAT, IF_FLAT, IF_LYING = -1, -2, -3, -4
# Two points carry the line on which a round piece lies, at this share of its half length: under even pressure a line
# that turns about its middle meets the friction torque of 0.5, one that slides along itself and turns that of 0.577.
EVEN_SHARE = 0.53
# Round pieces shorter than this share of their diameter lie on a line that hardly counts.
_SHORT = 0.25
# Points of faces and lines stand out by this much [m], so that outlines and ends touch only once the object tips.
PROTRUSION = 1e-5


@dataclass(frozen=True, eq=False)
class ConvexPiece:
    """One convex part of a body, in the body frame B (origin at the body's centre of mass).

    Build it with the factories in `shapes`, which check what they are given.

    Attributes:
        kind: SPHERE, CAPSULE, HULL or CYLINDER.
        vertices: (n, 3), m, frame B. Sphere: the centre. Capsule: the ends of its segment. Cylinder: the
            centres of its caps, in the order of the axis. Hull: its vertices.
        radius: m. Sphere, capsule and cylinder: their radius. Hull: 0.
        faces: Hull only: one loop of vertex indices per face, counter-clockwise seen from outside.
        hides: Cylinder: so many pieces that follow are touched only through its open ends.
        open_ends: Cylinder: whether its first end, and its second, is open.
    """

    kind: int
    vertices: np.ndarray
    radius: float = 0.0
    faces: tuple[tuple[int, ...], ...] = ()
    hides: int = 0
    open_ends: tuple[bool, bool] = (False, False)


class PieceTable(NamedTuple):
    """Every piece of every body as arrays: what the narrow phase is compiled for.

    int64 and float64, C order, SI; every coordinate is in the frame B of its body. All indices are global. A
    column called "first ..." has one row more than there are entries: those of entry i are
    [first[i], first[i + 1]).
    """

    bodies: np.ndarray  # (B + 1, 2). First piece, first floor point
    body_spheres: np.ndarray  # (B, 4), m. Centre and radius of a sphere about the body
    pieces: np.ndarray  # (P + 1, 4). Kind, first vertex, first face, first edge; only hulls have faces and edges
    # (P, 3). Number of pieces behind it, which follow it and are touched only through its open ends; flags of its ends
    shells: np.ndarray
    # (P, 4), m. Centre and radius of a sphere about the piece; the centre lies inside the piece
    piece_spheres: np.ndarray
    # (P, 4). Capsule or cylinder: unit vector from its first to its second vertex, and their distance, m. Else
    # zeros
    axes: np.ndarray
    vertices: np.ndarray  # (V, 4), m. Vertex, and radius of its piece (0 for a hull)
    faces: np.ndarray  # (F + 1,). First corner
    planes: np.ndarray  # (F, 4). Outward unit normal n, and offset, m: n . x = offset on the face
    # (K, 2). Vertex, and edge from it to the next corner: counter-clockwise about the face from outside
    corners: np.ndarray
    # (K, 4). For that edge the unit normal in the face's plane that points out of the face, and offset, m: a
    # point x of the plane lies in the face where n . x <= offset for all its sides
    sides: np.ndarray
    edges: np.ndarray  # (E, 4). v0, v1, face on the left going from v0 to v1 (seen from outside), face on the right
    edge_lines: np.ndarray  # (E, 4). Unit vector from v0 to v1, and length, m
    # (Q, 4), m. The points with which the body can touch a plane first, and their rounding radii: the vertices
    # of all hulls (of their common convex hull, where they are many), the centres of spheres, the ends of
    # capsules, and points fixed on the rims of cylinders
    floor_points: np.ndarray
    floor_owners: np.ndarray  # (Q,). Piece of the cylinder for a point on a rim; else ANYHOW to IF_LYING
    # (Q, 3). Outward unit normal of the flat face of UNLESS_FLAT and IF_FLAT, unit axis of IF_LYING, else zeros
    floor_faces: np.ndarray


def pack_pieces(
    pieces_of_body: list[list[ConvexPiece]],
    floor_points: Sequence[np.ndarray | None] = (),
    even_lines: Sequence[bool] = (),
) -> PieceTable:
    """Packs the pieces of all bodies into one table.

    Args:
        pieces_of_body: For each body its pieces, in the body's frame.
        floor_points: For each body the points with which it touches the floor, in its frame: (n, 3), m, or (n, 7)
            with when each counts (ANYHOW, UNLESS_FLAT or IF_FLAT) and its face (see `PieceTable`), beyond those of its
            round pieces; or None for those of all its pieces. Bodies beyond the end of the sequence have none of their
            own.
        even_lines: For each body whether the pressure is even on a line on which a round piece lies; otherwise, and
            beyond the end of the sequence, its ends carry it.

    Returns:
        The table; bodies, pieces and vertices keep their order.

    Raises:
        GeometryError: A body without pieces, an unknown kind, a vertex that is not finite, or a hull whose
            faces do not close.
    """
    for number, body in enumerate(pieces_of_body):
        if not body:
            raise GeometryError(f"body {number} has no pieces; allowed: one or more convex pieces")
    pieces = [piece for body in pieces_of_body for piece in body]
    for piece in pieces:
        if piece.kind not in (SPHERE, CAPSULE, HULL, CYLINDER):
            raise GeometryError(f"piece of kind {piece.kind}; allowed: SPHERE 0, CAPSULE 1, HULL 2, CYLINDER 3")
        if not np.all(np.isfinite(piece.vertices)):
            raise GeometryError("a piece has a vertex that is not finite; allowed: finite coordinates in metres")

    first_piece = _starts([len(body) for body in pieces_of_body])
    first_vertex = _starts([len(piece.vertices) for piece in pieces])
    hulls = [_hull_tables(piece) for piece in pieces]
    first_face = _starts([len(hull.planes) for hull in hulls])
    first_edge = _starts([len(hull.edges) for hull in hulls])
    kinds = np.array([piece.kind for piece in pieces] + [-1])
    spheres = np.array([_bounding_sphere(piece) for piece in pieces])
    floors = [
        _floor_points(body, int(first_piece[b])) if own is None else _own_floor_points(own, body, int(first_piece[b]))
        for b, (body, own) in enumerate(zip_longest(pieces_of_body, floor_points))
    ]
    for b, even in enumerate(even_lines):
        floors[b] = _with_lines(floors[b], pieces_of_body[b]) if even else floors[b]

    def shifted(block: np.ndarray, *shifts: np.ndarray) -> np.ndarray:
        return np.asarray(block + np.array(shifts))

    numbered = list(zip(hulls, first_vertex, first_face, first_edge, strict=False))
    return PieceTable(
        bodies=np.stack([first_piece, _starts([len(points) for points, *_ in floors])], axis=1),
        body_spheres=np.array([_union_sphere(spheres[s:e]) for s, e in pairwise(first_piece)]),
        pieces=np.stack([kinds, first_vertex, first_face, first_edge], axis=1),
        shells=np.array([[piece.hides, *piece.open_ends] for piece in pieces], np.int64),
        piece_spheres=spheres,
        axes=np.array([_axis(piece) for piece in pieces]),
        vertices=np.concatenate(
            [np.pad(piece.vertices.astype(float), ((0, 0), (0, 1)), constant_values=piece.radius) for piece in pieces]
        ),
        faces=_starts([count for hull in hulls for count in hull.corner_counts]),
        planes=np.concatenate([hull.planes for hull in hulls]),
        corners=np.concatenate([shifted(hull.corners, v, e) for hull, v, _, e in numbered]),
        sides=np.concatenate([hull.sides for hull in hulls]),
        edges=np.concatenate([shifted(hull.edges, v, v, f, f) for hull, v, f, _ in numbered]),
        edge_lines=np.concatenate([hull.edge_lines for hull in hulls]),
        floor_points=np.concatenate([points for points, *_ in floors]),
        floor_owners=np.concatenate([owners for _, owners, _ in floors]),
        floor_faces=np.concatenate([faces for *_, faces in floors]),
    )


class _HullTables(NamedTuple):
    """The tables of one hull, with its own indices; all empty for other kinds."""

    corner_counts: list[int]
    planes: np.ndarray
    corners: np.ndarray
    sides: np.ndarray
    edges: np.ndarray
    edge_lines: np.ndarray


def _hull_tables(piece: ConvexPiece) -> _HullTables:
    planes, corners, sides = [], [], []
    edge_of: dict[tuple[int, int], int] = {}
    edges: list[list[int]] = []
    for f, face in enumerate(piece.faces):
        points = piece.vertices[list(face)]
        following = np.roll(points, -1, axis=0)
        normal = np.cross(points - points[0], following - points[0]).sum(axis=0)
        normal /= np.linalg.norm(normal)
        planes.append([*normal, np.max(points @ normal)])
        outward = np.cross(following - points, normal)
        outward /= np.linalg.norm(outward, axis=1, keepdims=True)
        sides.append(np.column_stack([outward, np.sum(outward * points, axis=1)]))
        for v0, v1 in zip(face, face[1:] + face[:1], strict=True):
            if (v1, v0) in edge_of:
                edge = edge_of.pop((v1, v0))
                edges[edge][3] = f
            else:
                edge = edge_of[(v0, v1)] = len(edges)
                edges.append([v0, v1, f, -1])
            corners.append([v0, edge])
    if edge_of:
        raise GeometryError("the faces of a hull do not close: an edge has one face; allowed: two faces per edge")
    edge_table = np.array(edges, np.int64).reshape(-1, 4)
    spans = piece.vertices[edge_table[:, 1]] - piece.vertices[edge_table[:, 0]]
    lengths = np.linalg.norm(spans, axis=1, keepdims=True)
    return _HullTables(
        [len(face) for face in piece.faces],
        np.array(planes, float).reshape(-1, 4),
        np.array(corners, np.int64).reshape(-1, 2),
        np.concatenate([np.zeros((0, 4)), *sides]),
        edge_table,
        np.hstack([spans / lengths, lengths]),
    )


def _starts(counts: list[int]) -> np.ndarray:
    return np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)


def _axis(piece: ConvexPiece) -> np.ndarray:
    if piece.kind not in (CAPSULE, CYLINDER):
        return np.zeros(4)
    span = piece.vertices[1] - piece.vertices[0]
    length = np.linalg.norm(span)
    return np.append(span / length, length)


def _bounding_sphere(piece: ConvexPiece) -> np.ndarray:
    center = piece.vertices.mean(axis=0)
    reach = np.max(np.linalg.norm(piece.vertices - center, axis=1))
    return np.append(center, np.hypot(reach, piece.radius) if piece.kind == CYLINDER else reach + piece.radius)


def _union_sphere(spheres: np.ndarray) -> np.ndarray:
    centers, radii = spheres[:, :3], spheres[:, 3:]
    center = 0.5 * ((centers - radii).min(axis=0) + (centers + radii).max(axis=0))
    return np.append(center, np.max(np.linalg.norm(centers - center, axis=1) + radii[:, 0]))


# Of a body: points with radii (n, 4), owners (n,), and faces or axes (n, 3).
_Floor = tuple[np.ndarray, np.ndarray, np.ndarray]


def _floor_points(body: list[ConvexPiece], first_piece: int) -> _Floor:
    """Return the points of one body that a plane can touch, with their radii, their owners and faces."""
    from scipy.spatial import ConvexHull

    points, owners = [], []
    sharp = [body[i].vertices for i in touching_pieces(body) if body[i].kind == HULL]
    if sharp:
        # A vertex that pieces share (to 1e-9 m) comes once. A plane touches a union of pieces only where it
        # touches their common convex hull, so that of many vertices the inner ones drop out; of few they stay,
        # because on a face that lies on the floor they carry load, and the load's spread decides the friction
        # torque (8 corners of the T-block, as in MuJoCo and Bullet, not 6).
        cloud = np.concatenate(sharp)
        _, unique = np.unique(np.round(cloud, 9), axis=0, return_index=True)
        cloud = cloud[np.sort(unique)]
        if len(cloud) > MAX_FLOOR_POINTS:
            cloud = cloud[np.sort(ConvexHull(cloud).vertices)]
        points.append(np.pad(cloud, ((0, 0), (0, 1))))
        owners.append(np.full(len(points[0]), ANYHOW))
    rounded, rounded_owners = _rounded_floor_points(body, first_piece)
    together = np.concatenate([*points, rounded])
    return together, np.concatenate([*owners, rounded_owners]), np.zeros((len(together), 3))


def touching_pieces(body: list[ConvexPiece]) -> list[int]:
    """Indices of the pieces of a body that are behind no other: a floor touches no more."""
    hidden = {k for i, piece in enumerate(body) for k in range(i + 1, i + 1 + piece.hides)}
    return [i for i in range(len(body)) if i not in hidden]


def _rounded_floor_points(body: list[ConvexPiece], first_piece: int, step: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Points (n, 4), with radii, of the pieces that are no hulls, and their owners; of a rim each `step`-th."""
    points, owners = [np.zeros((0, 4))], [np.zeros(0, np.int64)]
    for i in touching_pieces(body):
        piece = body[i]
        if piece.kind == HULL:
            continue
        on_rim = piece.kind == CYLINDER
        block = rim_points(piece)[::step] if on_rim else piece.vertices
        points.append(np.pad(block, ((0, 0), (0, 1)), constant_values=0.0 if on_rim else piece.radius))
        owners.append(np.full(len(block), first_piece + i if on_rim else ANYHOW))
    return np.concatenate(points), np.concatenate(owners)


def _own_floor_points(
    points: np.ndarray, body: list[ConvexPiece], first_piece: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Given points in the form of `_floor_points`, and those of round pieces; GeometryError where they are none."""
    if points.ndim != 2 or points.shape[1] not in (3, 7) or len(points) == 0 or not np.all(np.isfinite(points)):
        raise GeometryError(f"floor points are {points.shape}; allowed: (n, 3) or (n, 7) finite numbers, n at least 1")
    rounded, rounded_owners = _rounded_floor_points(body, first_piece, step=2)
    placed = np.concatenate([np.pad(points[:, :3].astype(float), ((0, 0), (0, 1))), rounded])
    if points.shape[1] == 3:
        owners = np.append(np.full(len(points), ANYHOW), rounded_owners)
        return placed, owners, np.zeros((len(placed), 3))
    wrong = np.flatnonzero(~np.isin(points[:, 3], (ANYHOW, UNLESS_FLAT, IF_FLAT)))
    if len(wrong):
        row = int(wrong[0])
        raise GeometryError(f"floor point {row} counts when {points[row, 3]:g}; allowed: ANYHOW, UNLESS_FLAT, IF_FLAT")
    faces = np.pad(points[:, 4:].astype(float), ((0, len(rounded)), (0, 0)))
    return placed, np.append(points[:, 3].astype(np.int64), rounded_owners), faces


def line_points(piece: ConvexPiece) -> np.ndarray | None:
    """Points (2, 3) m on the axis of a round piece that carry it where it lies, as even pressure does; or None."""
    length = _axis(piece)[3]
    if length <= 2.0 * _SHORT * piece.radius:
        return None
    first, last = piece.vertices
    half = EVEN_SHARE * 0.5 * (last - first)
    return np.asarray(0.5 * (first + last) + np.array([-half, half]))


def _with_lines(floor: _Floor, body: list[ConvexPiece]) -> _Floor:
    """Return the floor points of a body with those of `line_points`, as thick as their pieces."""
    points, owners, faces = floor
    for i in touching_pieces(body):
        if (rows := line_points(body[i])) is not None:
            thick = np.pad(rows, ((0, 0), (0, 1)), constant_values=body[i].radius + PROTRUSION)
            points, owners = np.concatenate([points, thick]), np.append(owners, [IF_LYING] * 2)
            faces = np.concatenate([faces, [_axis(body[i])[:3]] * 2])
    return points, owners, faces


def rim_points(cylinder: ConvexPiece) -> np.ndarray:
    """Points fixed on both rims of a cylinder.

    Args:
        cylinder: A piece of kind CYLINDER.

    Returns:
        (2 RIM_POINTS, 3), m, frame B: first rim, then second.
    """
    axis = cylinder.vertices[1] - cylinder.vertices[0]
    axis = axis / np.linalg.norm(axis)
    across = np.eye(3)[int(np.argmin(np.abs(axis)))]
    across = across - (across @ axis) * axis
    across /= np.linalg.norm(across)
    angles = 2.0 * np.pi * np.arange(RIM_POINTS) / RIM_POINTS
    circle = np.outer(np.cos(angles), across) + np.outer(np.sin(angles), np.cross(axis, across))
    return np.concatenate([end + cylinder.radius * circle for end in cylinder.vertices])
