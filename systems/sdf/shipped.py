# SPDX-License-Identifier: MIT
"""Writing of the SDFormat files that ship with pinwm_drake, and of the meshes with which their objects touch.

Run `python -m pinwm_drake.systems.sdf.shipped` after a mesh, or how SDFormat is written, was changed. Beside each mesh
NAME/NAME.obj come NAME.sdf with NAME_contact.obj and NAME_support.vtk, for hydroelastic contact, NAME_point.sdf for
point contact, and pieces/NAME_k.obj, the convex pieces of the mesh. Mass is 1 kg, friction of every pair 0.1,
restitution 0.
"""

from functools import cache, partial
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from pinwm_drake.capture.scene import PusherShape
from pinwm_drake.geometry.convex import hollow_mug, t_block
from pinwm_drake.geometry.meshes import load_mesh, mass_properties
from pinwm_drake.geometry.pieces import ConvexPiece
from pinwm_drake.geometry.primitive import primitives_of
from pinwm_drake.geometry.shapes import box, convex_hull
from pinwm_drake.models import OBJECT_NAMES, PACKAGE_NAME, PUSHER_NAMES, model_path, object_model
from pinwm_drake.models.paint import HANDLE_CENTER, HANDLE_PARTS, HANDLE_WIDTH, LARGE_T
from pinwm_drake.systems.sdf.collision import (
    carrying_pieces,
    fine_mesh,
    met_mesh,
    piece_mesh,
    support_discs,
    support_spheres,
    volume_mesh,
)
from pinwm_drake.systems.sdf.contact import LONGEST_EDGE, SUPPORT_GRADIENT, Surfaces
from pinwm_drake.systems.sdf.text import Solid, floor_sdf, object_point_sdf, object_sdf, pusher_sdf

_MASS, _FRICTION = 1.0, 0.1  # kg, of every pair
_ABOUT = "Written by pinwm_drake.systems.sdf.shipped."
_MUG_SEGMENTS = 64  # as many as the mesh has
PUSHERS = {
    "sphere": PusherShape("sphere", 0.01),
    "capsule": PusherShape("capsule", 0.01, 0.06),
    "cylinder": PusherShape("cylinder", 0.01, 0.06),
}


def shipped_uri(name: str) -> str:
    """URL of a file in the package of models."""
    return f"package://{PACKAGE_NAME}/{name}"


@cache
def shipped_pieces(name: str) -> tuple[ConvexPiece, ...]:
    """Convex pieces of a shipped object, exactly; frame O, m."""
    if name == "cube":
        return (box(np.full(3, 0.06)),)
    if name == "mug":
        return tuple(hollow_mug(segments=_MUG_SEGMENTS))
    if name == "mug_handle":
        parts = [piece.vertices for piece in hollow_mug(segments=_MUG_SEGMENTS)]
        for part in HANDLE_PARTS:
            parts.append(np.concatenate([np.insert(part, 1, y, axis=1) for y in (-HANDLE_WIDTH, HANDLE_WIDTH)]))
        return tuple(convex_hull(part - HANDLE_CENTER) for part in parts)
    pieces = t_block()
    return tuple(pieces if name == "t_block" else (convex_hull(LARGE_T * piece.vertices) for piece in pieces))


def piece_name(name: str, k: int) -> str:
    """Name of the file of an object's convex piece of a number in the package of models."""
    return f"{name}/pieces/{name}_{k}.obj"


def piece_uri(name: str, k: int, piece: ConvexPiece) -> str:
    """URI of the mesh of a shipped object's piece of a number, as `object_point_sdf` asks for it."""
    return shipped_uri(piece_name(name, k))


def shipped_supports(name: str) -> list[tuple[np.ndarray, float]]:
    """Spheres on which a shipped object stands: centre (3,) [m, frame O] and radius [m] of each, from its file."""
    collisions = ElementTree.parse(object_model(name).point_sdf_path).iter("collision")
    spheres = [entry for entry in collisions if entry.get("name", "").startswith("support_")]
    return [
        (np.array(entry.findtext("pose", "").split()[:3], float), float(entry.findtext("geometry/sphere/radius", "")))
        for entry in spheres
        if entry.find("geometry/sphere") is not None
    ]


def shipped_support(name: str) -> tuple[str, float]:
    """URL and depth [m] of the tetrahedra on which a shipped object stands in hydroelastic contact."""
    sdf = ElementTree.parse(object_model(name).sdf_path)
    collision = next(one for one in sdf.iter("collision") if one.get("name") == "support")
    modulus = next(one.text for one in collision.iter() if one.tag.endswith("hydroelastic_modulus"))
    return shipped_uri(f"{name}/{name}_support.vtk"), float(modulus or "") / SUPPORT_GRADIENT


def texts() -> dict[Path, str]:
    """Text of every file that this module writes, by path."""
    root = model_path("package.xml").parent
    found: dict[str, str] = {}
    for name in OBJECT_NAMES:
        found |= _object_texts(name)
    surfaces = Surfaces.of_pairs(_FRICTION, _FRICTION)
    found["floor/floor.sdf"] = floor_sdf(surfaces, 0.0, f"Floor, z = 0. {_ABOUT}")
    for name in PUSHER_NAMES:
        size = " across, 60 mm long" if PUSHERS[name].length else ""
        found[f"pusher/{name}.sdf"] = pusher_sdf(PUSHERS[name], None, surfaces, f"Pusher, 20 mm{size}. {_ABOUT}")
    return {root / file: text for file, text in found.items()}


def _object_texts(name: str) -> dict[str, str]:
    mesh, pieces = load_mesh(model_path(f"{name}/{name}.obj")), shipped_pieces(name)
    about = mass_properties(mesh, mass=_MASS)
    # Nine digits, as in the mesh: a hundredth of a nanometre, which rounding makes of a centre of mass, is 0.
    inertia = np.vectorize(lambda value: float(f"{value:.9g}") if abs(value) > 1e-15 else 0.0)(about.inertia)
    solid = Solid(_MASS, about.p_com.round(9), inertia)
    surfaces = Surfaces.of_pairs(_FRICTION, _FRICTION)
    visual, contact, base = f"{name}/{name}_visual.obj", f"{name}/{name}_contact.obj", f"{name}/{name}_support.vtk"
    primitives = primitives_of(mesh, pieces)
    tetrahedra, depth = volume_mesh(carrying_pieces(pieces, primitives), LONGEST_EDGE)
    support = shipped_uri(base), round(depth, 12)
    spheres = [(centre.round(9), radius) for centre, radius in support_spheres(mesh, primitives=primitives)]
    comment = f"{name}, hydroelastic contact. {_ABOUT}"
    point = f"{name}, point contact: pieces are for the pusher, supports for the floor. {_ABOUT}"
    return {
        contact: fine_mesh(met_mesh(mesh, primitives), LONGEST_EDGE),
        base: tetrahedra,
        **{piece_name(name, k): piece_mesh(piece) for k, piece in enumerate(pieces)},
        f"{name}/{name}.sdf": object_sdf(
            name, solid, shipped_uri(visual), shipped_uri(contact), support, surfaces, comment
        ),
        f"{name}/{name}_point.sdf": object_point_sdf(
            name,
            solid,
            shipped_uri(visual),
            pieces,
            partial(piece_uri, name),
            spheres,
            surfaces,
            point,
            support_discs(mesh, primitives),
        ),
    }


if __name__ == "__main__":
    for path, text in texts().items():
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
