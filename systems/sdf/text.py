# SPDX-License-Identifier: MIT
"""Texts of SDFormat files: an object for hydroelastic and for point contact, the floor, and a pusher.

Their coefficients of contact are those of `contact.py`; elements that begin with `drake:` are Drake's own.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from xml.sax.saxutils import escape, quoteattr

import numpy as np
from pydrake.math import RollPitchYaw, RotationMatrix

from pinwm_drake.capture.scene import PusherShape
from pinwm_drake.geometry.pieces import CYLINDER, HULL, SPHERE, ConvexPiece
from pinwm_drake.systems.sdf import contact as settings
from pinwm_drake.systems.sdf.collision import as_box, plain_pieces

_GREY = "0.3 0.3 0.32 1"


@dataclass(frozen=True, eq=False)
class Solid:
    """Mass properties of a body.

    Attributes:
        mass: kg.
        p_OB: (3,) m, centre of mass B in the frame O of the link.
        inertia: (3, 3) kg m^2, about B, axes of O.
    """

    mass: float
    p_OB: np.ndarray
    inertia: np.ndarray


@dataclass(frozen=True)
class Surface:
    """Contact properties of a geometry for Drake.

    Attributes:
        friction: Coulomb coefficient, static and dynamic.
        dissipation: Hunt and Crossley's dissipation [s/m].
        stiffness: Stiffness in point contact [N/m]; None leaves it out.
        modulus: Hydroelastic modulus [Pa] of a compliant one, infinite for a rigid one; None for no hydroelastic
            contact.
        resolution: Length of the edges of the tetrahedra that it is divided into, m; None for those of a mesh.
    """

    friction: float
    dissipation: float = 0.0
    stiffness: float | None = None
    modulus: float | None = None
    resolution: float | None = None

    def text(self) -> str:
        """Element of SDFormat with these properties."""
        lines = []
        if self.modulus is not None:
            rigid = self.modulus == np.inf
            lines.append("<drake:rigid_hydroelastic/>" if rigid else "<drake:compliant_hydroelastic/>")
            if not rigid:
                lines.append(_tag("drake:hydroelastic_modulus", self.modulus))
        if self.resolution is not None:
            lines.append(_tag("drake:mesh_resolution_hint", self.resolution))
        if self.stiffness is not None:
            lines.append(_tag("drake:point_contact_stiffness", self.stiffness))
        lines.append(_tag("drake:hunt_crossley_dissipation", self.dissipation))
        lines += [_tag("drake:mu_dynamic", self.friction), _tag("drake:mu_static", self.friction)]
        return _element("drake:proximity_properties", *lines)


def object_sdf(
    name: str,
    solid: Solid,
    visual: str,
    contact_mesh: str,
    support: tuple[str, float],
    surfaces: settings.Surfaces,
    comment: str,
) -> str:
    """Model of a free body for hydroelastic contact: a rigid mesh for the pusher, soft tetrahedra for the floor.

    Args:
        name: Name of the model; its link is called "object" and has the frame O.
        solid: Mass properties.
        visual: URI of the mesh that is seen.
        contact_mesh: URI of the mesh that meets the pusher.
        support: URI and depth [m] of the tetrahedra that stand on the floor, as of `volume_mesh`.
        surfaces: Coefficients.
        comment: First line of the file.
    """
    surface = Surface(surfaces.friction_object, modulus=np.inf)
    modulus = settings.SUPPORT_GRADIENT * support[1]
    base = Surface(surfaces.friction_object, surfaces.dissipation_floor, modulus=modulus)
    parts = [_inertial(solid), _visual(_mesh(visual)), _collision("piece", _mesh(contact_mesh), surface)]
    parts.append(_collision("support", _mesh(support[0]), base))
    return _file(comment, name, _link("object", *parts))


def object_point_sdf(
    name: str,
    solid: Solid,
    visual: str,
    pieces: Sequence[ConvexPiece],
    mesh_uri: Callable[[int, ConvexPiece], str],
    supports: Sequence[tuple[np.ndarray, float]],
    surfaces: settings.Surfaces,
    comment: str,
    discs: Sequence[ConvexPiece] = (),
) -> str:
    """Model of a free body for point contact: convex pieces for the pusher, small spheres for the floor.

    Other arguments are those of `object_sdf`.

    Args:
        pieces: Convex pieces of the object, frame O, m.
        mesh_uri: Function of the number of a piece and the piece to the URI of its mesh; called for those that Drake
            meets as hulls of meshes, see `plain_pieces`.
        supports: Centre (3,) [m, frame O] and radius [m] of each sphere.
        discs: Cylinders that meet the floor as well, frame O, m.
    """
    # Of a pair of equal ones Drake takes half of the stiffness, and their dissipation.
    side = Surface(surfaces.friction_object, surfaces.dissipation_pusher, 2 * settings.PUSHER_STIFFNESS)
    base = Surface(surfaces.friction_object, surfaces.dissipation_floor, 2 * settings.FLOOR_STIFFNESS)
    parts = [_inertial(solid), _visual(_mesh(visual))]
    parts += [_piece(k, piece, mesh_uri, side) for k, piece in enumerate(plain_pieces(pieces))]
    parts += [
        _collision(f"support_{k}", _shape("sphere", radius=r), base, centre) for k, (centre, r) in enumerate(supports)
    ]
    parts += [_round(f"support_disc_{k}", disc, base) for k, disc in enumerate(discs)]
    return _file(comment, name, _link("object", *parts))


def floor_sdf(surfaces: settings.Surfaces, height: float, comment: str) -> str:
    """Model of the floor: a box that stands still, its top at a height [m]; no visual."""
    surface = Surface(
        surfaces.friction_floor,
        surfaces.dissipation_floor,
        2 * settings.FLOOR_STIFFNESS,
        settings.FLOOR_MODULUS,
        settings.FLOOR_SIDE,
    )
    sides = (settings.FLOOR_SIDE, settings.FLOOR_SIDE, settings.FLOOR_DEPTH)
    box = _element("box", f"<size>{_numbers(sides)}</size>")
    middle = np.array([*settings.FLOOR_MIDDLE, height - 0.5 * settings.FLOOR_DEPTH])
    link = _link("floor", _collision("floor", _element("geometry", box), surface, middle))
    return _file(comment, "floor", "<static>true</static>", link)


def pusher_sdf(
    shape: PusherShape | Sequence[str],
    visual: str | None,
    surfaces: settings.Surfaces,
    comment: str,
    *,
    driven: bool = True,
    touching: PusherShape | None = None,
) -> str:
    """Model of a pusher that translates along three axes of the world, each with a stiff drive to a desired state.

    Args:
        shape: Shape of the pusher, or the URIs of meshes whose convex hulls make it up.
        visual: URI of the mesh that is seen; None where it has a shape.
        surfaces: Coefficients.
        comment: First line of the file.
        driven: Whether it has the three joints and their drives; without, something else has to hold it.
        touching: Shape with which it touches, where that is not the shape that is seen.

    Returns:
        The text of the file; the link is called "pusher", the joints "pusher_x", "pusher_y", "pusher_z".
    """
    whole = isinstance(shape, PusherShape)
    surface = Surface(
        surfaces.friction_pusher,
        surfaces.dissipation_pusher,
        2 * settings.PUSHER_STIFFNESS,
        settings.PUSHER_MODULUS,
        settings.PUSHER_RESOLUTION if whole else None,
    )
    if isinstance(shape, PusherShape):
        seen = _pusher_shape(shape)
        collisions = [_collision("pusher", _pusher_shape(touching or shape), surface)]
        extent = shape.radius
    else:
        seen = _mesh(str(visual))
        collisions = [_collision(f"pusher_{k}", _mesh(uri, convex=True), surface) for k, uri in enumerate(shape)]
        extent = 0.01
    solid = Solid(settings.PUSHER_MASS, np.zeros(3), 0.4 * settings.PUSHER_MASS * extent**2 * np.eye(3))
    links = [_link("pusher", _inertial(solid), _visual(seen, _GREY), *collisions)]
    if driven:
        still = _inertial(Solid(0.0, np.zeros(3), np.zeros((3, 3))))
        chain = ["world", "pusher_slide_x", "pusher_slide_y", "pusher"]
        links = [*(_link(slide, still) for slide in chain[1:3]), *links]
        links += [_drive(axis, chain[k], chain[k + 1], np.eye(3)[k]) for k, axis in enumerate("xyz")]
    return _file(comment, "pusher", *links)


def _drive(axis: str, parent: str, child: str, direction: np.ndarray) -> str:
    gains = f'<drake:controller_gains p="{settings.DRIVE_STIFFNESS!r}" d="{settings.DRIVE_DAMPING!r}"/>'
    along = _element("axis", f"<xyz>{_numbers(direction)}</xyz>")
    ends = [f"<parent>{parent}</parent>", f"<child>{child}</child>"]
    return _element(f'joint name="pusher_{axis}" type="prismatic"', *ends, along, gains)


def _piece(k: int, piece: ConvexPiece, mesh_uri: Callable[[int, ConvexPiece], str], surface: Surface) -> str:
    name = f"piece_{k}"
    if piece.kind != HULL:
        return _round(name, piece, surface)
    found = as_box(piece)
    if found is None:
        return _collision(name, _mesh(mesh_uri(k, piece), convex=True), surface)
    sizes, X_OB = found
    box = _element("geometry", _element("box", f"<size>{_numbers(sizes.round(12))}</size>"))
    p, rpy = X_OB.translation().round(12), RollPitchYaw(X_OB.rotation()).vector().round(15)
    return _collision(name, box, surface, p, rpy)


def _round(name: str, piece: ConvexPiece, surface: Surface) -> str:
    p = piece.vertices.mean(axis=0).round(12)
    if piece.kind == SPHERE:
        return _collision(name, _shape("sphere", radius=piece.radius), surface, p)
    kind = "cylinder" if piece.kind == CYLINDER else "capsule"
    axis = piece.vertices[1] - piece.vertices[0]
    geometry = _shape(kind, radius=piece.radius, length=float(np.linalg.norm(axis).round(12)))
    R_OG = RotationMatrix.MakeFromOneVector(axis, 2)
    return _collision(name, geometry, surface, p, RollPitchYaw(R_OG).vector().round(15))


def _pusher_shape(shape: PusherShape) -> str:
    length = {} if shape.kind == "sphere" else {"length": shape.length}
    return _shape(shape.kind, radius=shape.radius, **length)


def _shape(kind: str, **sizes: float) -> str:
    return _element("geometry", _element(kind, *(_tag(name, size) for name, size in sizes.items())))


def _mesh(uri: str, *, convex: bool = False) -> str:
    declared = ["<drake:declare_convex/>"] if convex else []
    return _element("geometry", _element("mesh", *declared, f"<uri>{escape(uri)}</uri>"))


def _inertial(solid: Solid) -> str:
    places = [("ixx", 0, 0), ("ixy", 0, 1), ("ixz", 0, 2), ("iyy", 1, 1), ("iyz", 1, 2), ("izz", 2, 2)]
    moments = [_tag(name, solid.inertia[i, j]) for name, i, j in places]
    return _element("inertial", _pose(solid.p_OB), _tag("mass", solid.mass), _element("inertia", *moments))


def _visual(geometry: str, diffuse: str | None = None) -> str:
    colour = [] if diffuse is None else [_element("material", f"<diffuse>{diffuse}</diffuse>")]
    return _element('visual name="visual"', geometry, *colour)


def _collision(
    name: str, geometry: str, surface: Surface, p: np.ndarray | None = None, rpy: np.ndarray | None = None
) -> str:
    return _element(f'collision name="{name}"', *([] if p is None else [_pose(p, rpy)]), geometry, surface.text())


def _pose(p: np.ndarray, rpy: np.ndarray | None = None) -> str:
    return f"<pose>{_numbers(p)} {'0 0 0' if rpy is None or not rpy.any() else _numbers(rpy)}</pose>"


def _link(name: str, *parts: str) -> str:
    return _element(f'link name="{name}"', *parts)


def _file(comment: str, name: str, *parts: str) -> str:
    model = _element(f"model name={quoteattr(name)}", *parts)
    head = ['<?xml version="1.0"?>', f"<!-- {comment.replace('--', '- -')} -->"]
    return "\n".join([*head, _element('sdf version="1.9" xmlns:drake="http://drake.mit.edu"', model)]) + "\n"


def _element(head: str, *parts: str) -> str:
    inside = "\n".join(parts).replace("\n", "\n  ")
    return f"<{head}>\n  {inside}\n</{head.split()[0]}>"


def _tag(name: str, value: float) -> str:
    return f"<{name}>{_numbers([value])}</{name}>"


def _numbers(values: Sequence[float] | np.ndarray) -> str:
    """Text of numbers with the digits from which the same numbers are read again."""
    return " ".join(repr(float(value) + 0.0) for value in values)
