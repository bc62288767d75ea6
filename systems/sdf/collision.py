# SPDX-License-Identifier: MIT
"""Collision geometry for Drake: meshes of objects and pushers as texts of OBJ files, and spheres to stand on."""

from collections.abc import Sequence
from dataclasses import replace
from functools import cache, lru_cache
from itertools import pairwise, permutations, product

import manifold3d
import numpy as np
import trimesh
from pydrake.math import RigidTransform, RotationMatrix

from pinwm_drake.geometry.meshes import mass_properties
from pinwm_drake.geometry.patch import face_points, resting_normals, turned_down
from pinwm_drake.geometry.pieces import (
    CYLINDER,
    HULL,
    PROTRUSION,
    RIM_CORNERS,
    ConvexPiece,
    line_points,
    touching_pieces,
)
from pinwm_drake.geometry.primitive import Primitive, acting_mesh, acting_pieces, face_levels, fit
from pinwm_drake.geometry.shapes import box, convex_hull
from pinwm_drake.systems.sdf.contact import CORNER_RADIUS, SUPPORT_RADIUS

EVEN = (1.0, 1.0, 1.0)  # spread of uniform pressure
# Of the mean volume of a piece's tetrahedra: one of less is a sliver, whose sign may be that of a rounding.
_SLIVER = 1e-5
_SAME_SIDE = 1e-3  # between normals of one side
# Of a piece's longest edge: corners that are off by less are those of a box.
_SQUARE = 1e-7
_LATTICE = 33  # points along an edge of a box, for what stands out
DISC = 1e-4  # m, thickness of the discs on which a cylinder rolls
# Sides of the prism that a cylinder is for the floor, and divisions of what a sphere is: 3 and 34 µm of 40 mm are off.
SECTIONS, _DIVISIONS = 256, 4
_LID, _THIN, _NOTHING = 1e-6, 1e-6, 1e-12  # m, m, m^3


def met_pieces(pieces: Sequence[ConvexPiece], primitives: Sequence[Primitive]) -> list[ConvexPiece]:
    """Pieces that meet the pusher in point contact, frame of the mesh: primitives, but those with open ends.

    Args:
        pieces: Convex pieces of a mesh.
        primitives: What it acts as.
    """
    return [piece for piece in acting_pieces(pieces, primitives) if not any(piece.open_ends)]


def plain_pieces(pieces: Sequence[ConvexPiece]) -> list[ConvexPiece]:
    """Pieces with plain shapes in the place of hulls, in point contact with a pusher.

    Drake's normal between a sphere and the hull of a mesh is wrong near edges, often by tens of degrees; between a
    sphere and a box, cylinder, capsule or sphere it is right. A hull becomes one of these where it is that within the
    tolerance of `geometry.primitive`. It becomes its bounding box where that stands out of all hulls by no more: a
    slab of a mug's wall, whose narrow side is towards its neighbours. The others stay.

    Args:
        pieces: Convex pieces of a mesh, frame of the mesh, m.
    """
    return list(_plain_pieces(tuple(pieces)))


@lru_cache(maxsize=16)
def _plain_pieces(pieces: tuple[ConvexPiece, ...]) -> tuple[ConvexPiece, ...]:
    """`plain_pieces` of the same objects once: a plant is made many times in a process."""
    hulls = [trimesh.convex.convex_hull(piece.vertices) for piece in pieces if piece.kind == HULL]
    planes = [(hull.face_normals, face_levels(hull)) for hull in hulls]
    own = iter(planes)
    return tuple(_plain_piece(piece, [next(own), *planes]) if piece.kind == HULL else piece for piece in pieces)


def _plain_piece(piece: ConvexPiece, planes: Sequence[tuple[np.ndarray, np.ndarray]]) -> ConvexPiece:
    """`plain_pieces` of one hull; planes are those of itself, which most points are on, and of all hulls."""
    if as_box(piece) is not None:
        return piece
    to_box, extents = trimesh.bounds.oriented_bounds(piece.vertices)
    X_OB = np.linalg.inv(to_box)
    plain = box(extents, (X_OB[:3, :3], X_OB[:3, 3]))
    points = (_unit_surface() * extents) @ X_OB[:3, :3].T + X_OB[:3, 3]
    allowed = Primitive("box", tuple(extents)).tolerance
    for normals, levels in planes:
        points = points[(points @ normals.T - levels).max(axis=1) > allowed]
    if not len(points):
        return plain
    found = fit(piece.vertices)
    return piece if found is None else found.piece()


@cache
def _unit_surface() -> np.ndarray:
    """Points (n, 3) of a lattice on the surface of a cube with sides of 1."""
    lattice = np.linspace(-0.5, 0.5, _LATTICE)
    points = np.stack(np.meshgrid(lattice, lattice, lattice), axis=-1).reshape(-1, 3)
    return points[np.abs(points).max(axis=1) == 0.5]


def carrying_pieces(pieces: Sequence[ConvexPiece], primitives: Sequence[Primitive]) -> list[ConvexPiece]:
    """Hulls that carry an object in hydroelastic contact, frame of the mesh: a floor gets into no open end.

    Arguments are those of `met_pieces`. Round primitives are hulls of many sides.
    """
    acting = acting_pieces(pieces, primitives)
    kept = [acting[k] for k in touching_pieces(acting)]
    return [piece if piece.kind == HULL else convex_hull(_many_sides(piece).vertices, 1e-9) for piece in kept]


def met_mesh(mesh: trimesh.Trimesh, primitives: Sequence[Primitive]) -> trimesh.Trimesh:
    """Surface that meets the pusher in hydroelastic contact: that of a mesh, with primitives in the place of its parts.

    What is behind an open end of a primitive, as the cavity of a mug, stays. So do parts that stand out of it, as a
    handle.

    Args:
        mesh: Watertight, m.
        primitives: What it acts as, same frame.
    """
    others = [primitive for primitive in primitives if not primitive.is_mesh]
    if not others:
        return mesh
    solid = _manifold(mesh)
    for primitive in others:
        whole = _many_sides(primitive.piece())
        on = np.abs(primitive.depth(mesh.vertices)) < 2.0 * primitive.tolerance
        hull = _manifold(trimesh.convex.convex_hull(mesh.vertices[on]))
        hollow = _large(hull - solid)
        # Of the mesh only what stands out of the primitive is left.
        parts = [_large(solid - hull)]
        if any(primitive.open_ends):
            # Lower by a little, so that rounding leaves no lid on the cavity.
            low, high = (_LID if is_open else 0.0 for is_open in primitive.open_ends)
            whole.vertices = _between(primitive, whole.vertices, low, high)
            parts.append(_large(_manifold(whole) - hollow))
        else:
            parts.append(_manifold(whole))
        solid = _large(manifold3d.Manifold.batch_boolean(parts, manifold3d.OpType.Add))
    made = solid.simplify(_THIN).to_mesh64()
    return trimesh.Trimesh(np.array(made.vert_properties[:, :3]), np.array(made.tri_verts, int), process=False)


def _large(solid: manifold3d.Manifold) -> manifold3d.Manifold:
    """Return a solid without parts that are no more than rounding."""
    return manifold3d.Manifold.compose([part for part in solid.decompose() if abs(part.volume()) > _NOTHING])


def _between(primitive: Primitive, points: np.ndarray, low: float, high: float) -> np.ndarray:
    """Points (n, 3) of a cylinder moved along its axis, to be this far [m] from its ends or farther."""
    axis = primitive.R_OG[:, 2]
    along = (points - np.array(primitive.p)) @ axis
    half = primitive.half[2]
    return np.asarray(points + np.outer(np.clip(along, low - half, half - high) - along, axis))


def _manifold(mesh: trimesh.Trimesh) -> manifold3d.Manifold:
    vertices, faces = np.ascontiguousarray(mesh.vertices, float), np.ascontiguousarray(mesh.faces, np.uint64)
    return manifold3d.Manifold(manifold3d.Mesh64(vertices, faces))


def _many_sides(piece: ConvexPiece) -> trimesh.Trimesh:
    """Mesh of a piece; of a sphere or capsule with its corners on it, of a cylinder with its sides on it."""
    if piece.kind == HULL:
        return trimesh.convex.convex_hull(piece.vertices)
    if piece.kind == CYLINDER:
        return trimesh.convex.convex_hull(_rims(replace(piece, radius=piece.radius / np.cos(np.pi / SECTIONS))))
    ball = trimesh.creation.icosphere(_DIVISIONS, piece.radius).vertices
    return trimesh.convex.convex_hull((piece.vertices[:, None] + ball).reshape(-1, 3))


def _rims(cylinder: ConvexPiece, number: int = SECTIONS) -> np.ndarray:
    """Points (2 number, 3) m evenly on the rims of a cylinder."""
    R, angles = turned_down(cylinder.vertices[0] - cylinder.vertices[1]), 2.0 * np.pi * np.arange(number) / number
    across = R[:2] / np.linalg.norm(R[:2], axis=1, keepdims=True)
    circle = cylinder.radius * np.column_stack([np.cos(angles), np.sin(angles)]) @ across
    return np.concatenate([end + circle for end in cylinder.vertices])


def fine_mesh(mesh: trimesh.Trimesh, longest_edge: float) -> str:
    """OBJ file of a mesh with its triangles divided, for hydroelastic contact.

    Drake puts one contact at the centroid of every polygon of a contact surface; on a floor these are the object's
    triangles. Two large ones would neither hold a box upright nor show the friction torque of its face.

    Args:
        mesh: Metres, watertight.
        longest_edge: Longest edge of a triangle, m for each metre of the mesh's mean extent.
    """
    triangles = divided(mesh.triangles, longest_edge * float(mesh.extents.mean()))
    # Corners in the order in which they come, each once.
    lines = [f"v {' '.join(f'{x + 0.0:.12g}' for x in corner)}" for corner in triangles.reshape(-1, 3).round(15)]
    number = {line: k for k, line in enumerate(dict.fromkeys(lines), start=1)}
    faces = [" ".join(str(number[line]) for line in lines[k : k + 3]) for k in range(0, len(lines), 3)]
    return "\n".join([*number, *(f"f {face}" for face in faces)]) + "\n"


def divided(triangles: np.ndarray, longest_edge: float) -> np.ndarray:
    """Triangles of a mesh, halved across their longest edge until none is longer than allowed.

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


def piece_mesh(piece: ConvexPiece) -> str:
    """OBJ file of a convex hull."""
    corners = [f"v {' '.join(f'{x + 0.0:.9g}' for x in corner.round(15))}" for corner in piece.vertices]
    faces = [f"f {' '.join(str(corner + 1) for corner in face)}" for face in piece.faces]
    return "\n".join([*corners, *faces]) + "\n"


def as_box(piece: ConvexPiece) -> tuple[np.ndarray, RigidTransform] | None:
    """Sizes (3,) m of a box, and the pose X_OB of its frame B in that of the piece; None for another shape.

    Axes of B are as near to those of the piece as can be. Drake knows where a box is touched at an edge; with the hull
    of a mesh the normal at an edge was wrong by 28 degrees.

    Args:
        piece: The piece, m.
    """
    if len(piece.vertices) != 8 or sorted(map(len, piece.faces)) != 6 * [4]:
        return None
    corner, others = piece.vertices[0], piece.vertices[_next_to_the_first(piece)]
    edges = others - corner
    lengths = np.linalg.norm(edges, axis=1)
    axes = edges / lengths[:, None]
    corners = corner + np.array(list(product((0, 1), repeat=3))) @ edges
    off = np.linalg.norm(corners[:, None] - piece.vertices, axis=2).min(axis=1).max()
    if off > _SQUARE * lengths.max() or np.abs(axes @ axes.T - np.eye(3)).max() > _SQUARE:
        return None
    order = max(permutations(range(3)), key=lambda rows: float(np.abs(axes[list(rows)].diagonal()).sum()))
    axes, lengths = axes[list(order)], lengths[list(order)]
    axes *= np.where(axes.diagonal() < 0, -1.0, 1.0)[:, None]
    axes[np.abs(axes.diagonal()).argmin()] *= np.sign(np.linalg.det(axes))
    return lengths, RigidTransform(RotationMatrix.ProjectToRotationMatrix(axes.T), corners.mean(axis=0))


def _next_to_the_first(piece: ConvexPiece) -> list[int]:
    around = [face for face in piece.faces if 0 in face]
    return sorted({face[face.index(0) - 1] for face in around} | {face[(face.index(0) + 1) % 4] for face in around})


def volume_mesh(pieces: Sequence[ConvexPiece], longest_edge: float) -> tuple[str, float]:
    """VTK file of convex pieces as tetrahedra, for hydroelastic contact with a stiffer floor, and their depth [m].

    The faces of a piece are divided as `fine_mesh` does it, and each triangle makes a tetrahedron with the piece's
    middle: Drake's pressure is zero on every face and grows inwards. Vertices on the line between two others
    are left out.

    Args:
        pieces: The pieces, m.
        longest_edge: Longest edge of a triangle, m for each metre of the pieces' mean extent.

    Returns:
        The file, and the largest distance of a piece's middle from its surface, where the pressure is the modulus.

    Raises:
        GeometryError: A piece is flat.
    """
    extents = np.ptp(np.concatenate([piece.vertices for piece in pieces]), axis=0)
    points: list[np.ndarray] = []
    cells: list[tuple[int, ...]] = []
    depth = 0.0
    for piece in map(_without_slivers, pieces):
        corners, middle = piece.vertices[_fans(piece)], piece.vertices.mean(axis=0)
        nearest = trimesh.triangles.closest_point(corners, np.tile(middle, (len(corners), 1)))
        depth = max(depth, float(np.linalg.norm(nearest - middle, axis=1).min()))
        triangles = divided(corners, longest_edge * float(extents.mean())).round(15)
        mine, index = np.unique(triangles.reshape(-1, 3), axis=0, return_inverse=True)
        first, last = len(points), len(points) + len(mine)
        points += [*mine, middle]
        # Seen from outside the first three turn the other way round, so that the fourth is on their left-handed side.
        cells += [(a, c, b, last) for a, b, c in first + index.reshape(-1, 3)]
    lines = [
        "# vtk DataFile Version 3.0",
        "pieces",
        "ASCII",
        "DATASET UNSTRUCTURED_GRID",
        f"POINTS {len(points)} double",
    ]
    lines += [" ".join(f"{x + 0.0:.12g}" for x in point) for point in points]
    lines += [f"CELLS {len(cells)} {5 * len(cells)}", *(f"4 {a} {b} {c} {d}" for a, b, c, d in cells)]
    lines += [f"CELL_TYPES {len(cells)}", *["10"] * len(cells)]
    return "\n".join(lines) + "\n", depth


def _without_slivers(piece: ConvexPiece) -> ConvexPiece:
    """Return the hull without vertices that are all but on the line between two others.

    A triangle with such a vertex makes no tetrahedron with the hull's middle, and Drake refuses a file with one that
    is turned inwards by rounding. If it were left out, its neighbours' sides would count as surface, and with them the
    middle, where the pressure is not zero.
    """
    while True:
        triangles = _fans(piece)
        corners = piece.vertices[triangles]
        volumes = np.linalg.det(corners - piece.vertices.mean(axis=0))
        k = volumes.argmin()
        if volumes[k] > _SLIVER * volumes.mean():
            return piece
        # The vertex opposite the longest edge.
        edge = np.linalg.norm(np.roll(corners[k], -1, axis=0) - corners[k], axis=1).argmax()
        piece = convex_hull(np.delete(piece.vertices, triangles[k, edge - 1], axis=0))


def _fans(piece: ConvexPiece) -> np.ndarray:
    return np.array([(face[0], b, c) for face in piece.faces for b, c in pairwise(face[1:])])


def seen_mesh(mesh: trimesh.Trimesh) -> str:
    """OBJ file of a mesh with a normal for each face, as Drake's renderers want it."""
    lines = [f"v {' '.join(f'{x + 0.0:.9g}' for x in corner)}" for corner in mesh.vertices]
    lines += [f"vn {' '.join(f'{x + 0.0:.9g}' for x in normal)}" for normal in mesh.face_normals]
    lines += [f"f {' '.join(f'{corner}//{k}' for corner in face)}" for k, face in enumerate(mesh.faces + 1, start=1)]
    return "\n".join(lines) + "\n"


def support_spheres(
    mesh: trimesh.Trimesh,
    spread: Sequence[float] = EVEN,
    down: np.ndarray | None = None,
    primitives: Sequence[Primitive] = (),
) -> list[tuple[np.ndarray, float]]:
    """Spheres with which an object touches a floor in point contact.

    On each flat side that it can rest on they are where `spread_points` puts the pressure, and stand out by their
    radius; the corners of the convex hull have smaller ones, on which it tips, rolls and falls. Spheres
    and capsules have spheres of their own; the rims of cylinders have one at each corner, and `support_discs`.

    Args:
        mesh: Watertight, m, frame O.
        spread: (3,) factors of the spread of the pressure on a face along the axes of O: `support_*` of a twin.
        down: (3,) outward normal of the side that lies on the floor all the time; None where any may come to. Only
            there may points leave the side: elsewhere they would touch the floor while another side lies on it. Where
            points of any side would, the other sides have uniform pressure.
        primitives: What the object acts as, frame O.

    Returns:
        Centre (3,) [m, frame O] and radius [m] of each.
    """
    mesh = acting_mesh(mesh, primitives)
    spheres, sides = [], resting_normals(mesh)
    all_fit = all(stays_within(mesh, normal, spread) for normal in sides)
    for normal in sides:
        fits = all_fit or (down is not None and np.linalg.norm(normal - down) < _SAME_SIDE)
        points = spread_points(mesh, normal, spread if fits else EVEN)
        if points is not None:
            spheres += [(point, SUPPORT_RADIUS) for point in points - PROTRUSION * normal]
    corners = np.asarray(trimesh.convex.convex_hull(mesh.vertices).vertices)
    for primitive in primitives:
        if primitive.kind == "box":
            continue
        corners = corners[np.abs(primitive.depth(corners)) > 2.0 * primitive.tolerance]
        piece = primitive.piece()
        if piece.kind == CYLINDER:
            spheres += _rim_spheres(piece)
        else:
            spheres += [(end, piece.radius) for end in piece.vertices]
    return spheres + [(corner, CORNER_RADIUS) for corner in corners]


def _rim_spheres(cylinder: ConvexPiece) -> list[tuple[np.ndarray, float]]:
    """Spheres at the corners of a cylinder's rims, on which it comes to rest as the polygon of the twin does.

    On a disc alone a tilted cylinder rolls about its rim without loss. They stand out of the ends by less than half as
    much as the spheres of a face, and are within the round side: where the axis tilts by 4 degrees or more, the disc
    touches.
    """
    inner = replace(cylinder, radius=cylinder.radius - SUPPORT_RADIUS)
    out = 3.0 * CORNER_RADIUS  # of their middles
    along = cylinder.vertices[1] - cylinder.vertices[0]
    along /= np.linalg.norm(along)
    rims = _rims(inner, RIM_CORNERS).reshape(2, RIM_CORNERS, 3)
    return [(point + out * away, CORNER_RADIUS) for away, rim in ((-along, rims[0]), (along, rims[1])) for point in rim]


def support_discs(
    mesh: trimesh.Trimesh, primitives: Sequence[Primitive], spread: Sequence[float] = EVEN
) -> list[ConvexPiece]:
    """Thin discs of cylinders, on which an object rolls, tips and lies in point contact, frame O.

    Drake finds one point of a cylinder that touches a floor; of two it makes a line. So there is one at each end, and
    two that stand out a little, where the pressure on the line is on which a cylinder or capsule lies.

    Args:
        mesh: Watertight, m, frame O.
        primitives: What the object acts as, frame O.
        spread: (3,), as for `support_spheres`.
    """
    foot, discs = mass_properties(mesh, mass=1.0).p_com, []

    def disc(middle: np.ndarray, axis: np.ndarray, radius: float) -> ConvexPiece:
        return ConvexPiece(CYLINDER, middle + np.outer([-0.5 * DISC, 0.5 * DISC], axis), radius)

    for piece in (one.piece() for one in primitives if one.kind in ("cylinder", "capsule")):
        axis = piece.vertices[1] - piece.vertices[0]
        axis /= np.linalg.norm(axis)
        if piece.kind == CYLINDER:
            first, last = piece.vertices
            discs += [disc(end, axis, piece.radius) for end in (first + 0.5 * DISC * axis, last - 0.5 * DISC * axis)]
        if (line := line_points(piece)) is not None:
            wider = ((line - foot) @ axis) * float(np.square(axis) @ (np.asarray(spread) - 1.0))
            radius = round(piece.radius + SUPPORT_RADIUS, 12)
            discs += [disc(point, axis, radius) for point in line + np.outer(wider, axis)]
    return discs


def spread_points(mesh: trimesh.Trimesh, normal: np.ndarray, spread: Sequence[float]) -> np.ndarray | None:
    """Points that carry an object on one side, with the pressure spread as by `geometry.floor.spread_point`.

    Args:
        mesh: Watertight, m, frame O.
        normal: (3,) outward normal of the side.
        spread: (3,) factors along the axes of O, about the foot of the uniform solid's centre of mass.

    Returns:
        (n, 3) m, frame O, standing out by `PROTRUSION`; None where the side is not flat.
    """
    points = face_points(mesh, turned_down(normal))
    if points is None:
        return None
    level, middle = np.eye(3) - np.outer(normal, normal), mass_properties(mesh, mass=1.0).p_com
    return np.asarray(points + ((points - middle) @ level * (np.asarray(spread) - 1.0)) @ level)


def stays_within(mesh: trimesh.Trimesh, normal: np.ndarray, spread: Sequence[float]) -> bool:
    """Flag: no point of `spread_points` leaves the convex hull but by `PROTRUSION`, or there are none.

    Args:
        mesh: Watertight, m, frame O.
        normal: (3,) outward normal of the side.
        spread: (3,) factors along the axes of O.
    """
    points = spread_points(mesh, normal, spread)
    if points is None:
        return True
    hull = trimesh.convex.convex_hull(mesh.vertices)
    outside = ((points[:, None] - hull.triangles[None, :, 0]) * hull.face_normals[None]).sum(axis=-1)
    return bool(outside.max() < 2.0 * PROTRUSION)
