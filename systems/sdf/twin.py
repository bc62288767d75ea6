# SPDX-License-Identifier: MIT
"""SDFormat of a twin: its object with the identified theta, the floor, and its pusher, with their meshes."""

import dataclasses
from pathlib import Path
from typing import Literal, cast, get_args

import numpy as np
import torch

from pinwm_drake.capture.scene import PusherShape
from pinwm_drake.errors import require
from pinwm_drake.files import prepare_folder, replacing
from pinwm_drake.geometry.meshes import load_mesh, mass_properties
from pinwm_drake.geometry.patch import resting_normals
from pinwm_drake.geometry.pieces import ConvexPiece
from pinwm_drake.geometry.shapes import sphere
from pinwm_drake.geometry.stored_pieces import mesh_pieces
from pinwm_drake.physics.model import Body, Model
from pinwm_drake.scene import Scene
from pinwm_drake.systems.sdf.collision import (
    carrying_pieces,
    fine_mesh,
    met_mesh,
    met_pieces,
    piece_mesh,
    seen_mesh,
    stays_within,
    support_discs,
    support_spheres,
    volume_mesh,
)
from pinwm_drake.systems.sdf.colours import coloured_mesh
from pinwm_drake.systems.sdf.contact import LONGEST_EDGE, REFERENCE_SPEED, Surfaces
from pinwm_drake.systems.sdf.text import Solid, floor_sdf, object_point_sdf, object_sdf, pusher_sdf
from pinwm_drake.twin.rollout import NO_EFFECT, SUPPORT, twin_parameters
from pinwm_drake.twin.twin import Twin

ContactName = Literal["hydroelastic", "point"]
FILES = ("object.sdf", "object_point.sdf", "floor.sdf", "pusher.sdf")
_MESHES = "meshes"
_VISUAL = f"{_MESHES}/visual.obj"


def contact_name(text: str) -> ContactName:
    """Return validated name of one of Drake's contact models; raises ParameterError where there is no such model."""
    require("contact", repr(text), text in get_args(ContactName), ", ".join(get_args(ContactName)))
    return cast(ContactName, text)


def write_twin_model(twin: Twin, folder: Path) -> list[Path]:
    """Write a twin as models that Drake's Parser loads.

    `object.sdf` is for hydroelastic contact and `object_point.sdf` for point contact; `floor.sdf` and `pusher.sdf`
    have the surfaces with which Drake's pairs get the friction of theta. Meshes are named relative to the files.

    Args:
        twin: The twin.
        folder: Folder of the models; made if need be.

    Raises:
        InputError: A mesh cannot be used, or a file cannot be written.
    """
    prepare_folder(folder / _MESHES)
    about, surfaces = f"of the twin {twin.name}, by pinwm model. SI units.", twin_surfaces(twin)
    pieces = f"Object, pieces for the pusher and supports for the floor, {about}"
    found = (
        object_text(twin, surfaces, "hydroelastic", folder, "", f"Object {about}"),
        object_text(twin, surfaces, "point", folder, "", pieces, visual=_VISUAL),
        floor_sdf(surfaces, twin.floor_height, f"Floor {about}"),
        pusher_text(twin, surfaces, folder, "", f"Pusher {about}"),
    )
    paths = [folder / name for name in FILES]
    for path, text in zip(paths, found, strict=True):
        _write(path, text)
    return paths


def twin_surfaces(twin: Twin, reference_speed: float = REFERENCE_SPEED) -> Surfaces:
    """Surfaces whose pairs have a twin's friction, and its restitution at a speed of approach [m/s]."""
    names = ("friction_floor", "friction_pusher", "restitution_floor", "restitution_pusher")
    theta = {name: twin.theta[name].value for name in names}
    return Surfaces.of_pairs(**theta, reference_speed=reference_speed)


def nuisance_of(twin: Twin, name: str) -> float:
    """Value of a nuisance of the physics, one of `NO_EFFECT`; that without effect where the twin has none."""
    return twin.nuisance[name].value if name in twin.nuisance else NO_EFFECT[name]


def twin_spread(twin: Twin) -> tuple[float, ...]:
    """Factors (3,) of the spread of the pressure on a face along the axes of O."""
    return tuple(nuisance_of(twin, name) for name in SUPPORT)


def not_carried(twin: Twin, contact: ContactName, down: np.ndarray | None) -> list[str]:
    """Names of the parameters of a twin's physics that the plant of a contact model does not take over.

    Hydroelastic contact presses evenly on a face. So do points of a side that would leave it, see `support_spheres`. A
    pusher that is a mesh, or would have no radius left, is not made larger or smaller. Parameters without effect are
    not named.

    Args:
        twin: The twin.
        contact: Contact model of the plant.
        down: (3,) outward normal, frame O, of the side that lies on the floor all the time; None where any may come to.

    Raises:
        InputError: The mesh cannot be used.
    """
    mesh, spread = load_mesh(twin.mesh_path), twin_spread(twin)
    even = contact == "hydroelastic"
    even = even or (down is None and not all(stays_within(mesh, normal, spread) for normal in resting_normals(mesh)))
    names = list(SUPPORT) if even else []
    if _contact_shape(twin) == twin.pusher.shape:
        names.append("contact_offset")
    return [name for name in names if nuisance_of(twin, name) != NO_EFFECT[name]]


def _contact_shape(twin: Twin) -> PusherShape | None:
    """Shape with which the pusher touches: its own, larger by the contact offset where it has a shape."""
    shape, offset = twin.pusher.shape, nuisance_of(twin, "contact_offset")
    if shape is None or shape.radius + offset <= 0.0:
        return shape
    length = max(shape.length + 2.0 * offset, 0.0) if shape.kind == "cylinder" else shape.length
    return dataclasses.replace(shape, radius=shape.radius + offset, length=length)


def twin_solid(twin: Twin) -> Solid:
    """Mass properties of a twin's object; its centre of mass is that of a uniform solid.

    Raises:
        InputError: The mesh cannot be used.
    """
    mesh = load_mesh(twin.mesh_path)
    about = mass_properties(mesh, mass=1.0)
    # Of the scene, theta takes no more than the uniform solid's inertia.
    body = Body("object", [sphere(1.0)], 1.0, 0.5 * (about.inertia + about.inertia.T))
    theta = twin_parameters(twin, Scene(Model([body]), torch.from_numpy(about.p_com), mesh))
    p_com = about.p_com + theta.center[0, 0].numpy()
    return Solid(float(theta.mass[0, 0]), p_com, theta.inertia[0, 0].numpy())


def object_text(
    twin: Twin,
    surfaces: Surfaces,
    contact: ContactName,
    folder: Path,
    prefix: str,
    comment: str,
    *,
    visual: str | None = None,
    down: np.ndarray | None = None,
) -> str:
    """SDFormat of a twin's object; writes its meshes.

    Args:
        twin: The twin.
        surfaces: Coefficients of its contacts.
        contact: Contact model that the text is for.
        folder: Folder in whose subfolder `meshes` the meshes are written.
        prefix: Prefix of the names of meshes in the text; empty, or the folder with a slash.
        comment: First line of the text.
        visual: URI of a mesh to be seen instead of the twin's mesh in the colours of its surfels.
        down: (3,) outward normal, frame O, of the side that lies on the floor all the time; see `support_spheres`.

    Raises:
        InputError: The mesh cannot be used, or a file cannot be written.
    """
    mesh, solid = load_mesh(twin.mesh_path), twin_solid(twin)
    if visual is None:
        (folder / _MESHES).mkdir(exist_ok=True)
        seen, colours = coloured_mesh(mesh, twin.surfels, "visual.mtl")
        visual = prefix + _VISUAL
        _write(folder / _VISUAL, seen)
        _write((folder / _VISUAL).with_suffix(".mtl"), colours)
    if contact == "hydroelastic":
        fine = _mesh_file(folder, "contact", fine_mesh(met_mesh(mesh, twin.acts_as), LONGEST_EDGE))
        carrying = carrying_pieces(mesh_pieces(twin.mesh_path), twin.acts_as)
        tetrahedra, depth = volume_mesh(carrying, LONGEST_EDGE)
        base = _mesh_file(folder, "support", tetrahedra, ".vtk")
        return object_sdf("object", solid, visual, prefix + fine, (prefix + base, depth), surfaces, comment)
    pieces = met_pieces(mesh_pieces(twin.mesh_path), twin.acts_as)
    supports = support_spheres(mesh, twin_spread(twin), down, twin.acts_as)
    discs = support_discs(mesh, twin.acts_as, twin_spread(twin))

    def mesh_uri(k: int, piece: ConvexPiece) -> str:
        return prefix + _mesh_file(folder, f"piece_{k}", piece_mesh(piece))

    return object_point_sdf("object", solid, visual, pieces, mesh_uri, supports, surfaces, comment, discs)


def pusher_text(twin: Twin, surfaces: Surfaces, folder: Path, prefix: str, comment: str, *, driven: bool = True) -> str:
    """SDFormat of a twin's pusher; writes the meshes of one without a shape.

    Arguments are those of `object_text` and, `driven`, of `pusher_sdf`.

    Raises:
        InputError: A mesh cannot be used, or a file cannot be written.
    """
    pusher = twin.pusher
    if pusher.shape is not None or pusher.mesh_path is None:
        touching = _contact_shape(twin)
        return pusher_sdf(pusher.shape or [], None, surfaces, comment, driven=driven, touching=touching)
    hulls = mesh_pieces(pusher.mesh_path)
    pieces = [prefix + _mesh_file(folder, f"pusher_{k}", piece_mesh(hull)) for k, hull in enumerate(hulls)]
    visual = prefix + _mesh_file(folder, "pusher_visual", seen_mesh(load_mesh(pusher.mesh_path)))
    return pusher_sdf(pieces, visual, surfaces, comment, driven=driven)


def _mesh_file(folder: Path, name: str, text: str, suffix: str = ".obj") -> str:
    (folder / _MESHES).mkdir(exist_ok=True)
    _write(folder / _MESHES / f"{name}{suffix}", text)
    return f"{_MESHES}/{name}{suffix}"


def _write(path: Path, text: str) -> None:
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
