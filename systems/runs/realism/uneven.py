# SPDX-License-Identifier: MIT
"""Objects that are no uniform solids on flat faces: a lump within, and feet that stand out of the face below."""

import dataclasses
import math
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh
from scipy.spatial import ConvexHull, QhullError

from pinwm_drake.errors import GeometryError
from pinwm_drake.geometry.meshes import load_mesh, mass_properties
from pinwm_drake.geometry.stored_pieces import BESIDE, mesh_pieces, mesh_primitives
from pinwm_drake.reading.contents import read_text
from pinwm_drake.twin.twin import Estimate, Twin

_FOOT_HEIGHT = 7e-5  # m, by which feet stand out
_FOOT_RADIUS, _FOOT_LENGTH = 0.003, 0.002  # m, of the discs that are feet
_OFF = (0.02, 0.08)  # of the object's mean extent, from the uniform solid's centre of mass to the true one
_LUMP_SHARE = (0.15, 0.40)  # of the mass
_LUMP_RADIUS = 0.008  # m
_FEET = (3, 4)
_OUTWARDS = (0.6, 0.95)  # of the way from the middle to the outline
_BASE = 0.002  # m, from the lowest corner to those that count as the face below
_SAFE = 0.006  # m, from the centre of mass to the edge of the polygon of feet, at least
_ATTEMPTS = 1000
_SAME = 1e-6  # m, between heights that are one
_ROUGH = math.radians(3.0)  # to the normal of a face that belongs to the one below, as scanned surfaces have them
_ROLLS = math.radians(15.0)  # to the next side, over which an object rolls by itself


@dataclass(frozen=True, eq=False)
class Unevenness:
    """Mass and stand of an object that is no uniform solid on a flat face.

    Attributes:
        p_com: (3,) m, centre of mass, frame O.
        inertia: (3, 3) kg m^2, about the centre of mass, axes of O.
        feet: (n, 3) m, frame O: points that stand out of the face below and carry the object.
    """

    p_com: np.ndarray
    inertia: np.ndarray
    feet: np.ndarray


def uneven_twin(twin: Twin, up: np.ndarray, generator: np.random.Generator, folder: Path, *, feet: bool = True) -> Twin:
    """Twin of an object with a lump within, and feet below.

    Args:
        twin: The object as a uniform solid.
        up: (3,), axis of O that points up.
        generator: Source of randomness.
        folder: Folder of the new mesh.
        feet: Flag: it stands on feet.

    Raises:
        InputError: The mesh cannot be used.
        GeometryError: No lump or no feet were found that leave the object standing.
    """
    mesh, mass = load_mesh(twin.mesh_path), twin.theta["mass"].value
    hulls = [piece.vertices for piece in mesh_pieces(twin.mesh_path)]
    found = draw_unevenness(mesh, hulls, mass, up, generator)
    plain = mass_properties(mesh, mass=mass).p_com
    theta = {f"inertia_{2 * axis}": float(found.inertia[k, k]) for k, axis in enumerate("xyz")}
    off = {f"center_{axis}": float(found.p_com[k] - plain[k]) for k, axis in enumerate("xyz")}
    path = write_with_feet(twin.mesh_path, folder, found.feet, up) if feet else twin.mesh_path
    return dataclasses.replace(
        twin,
        mesh_path=path,
        acts_as=mesh_primitives(path) if feet and twin.acts_as else twin.acts_as,
        theta=twin.theta | {name: dataclasses.replace(twin.theta[name], value=value) for name, value in theta.items()},
        nuisance=twin.nuisance | {name: Estimate(value, None, True, "m", "drawn") for name, value in off.items()},
    )


def draw_unevenness(
    mesh: trimesh.Trimesh, hulls: Sequence[np.ndarray], mass: float, up: np.ndarray, generator: np.random.Generator
) -> Unevenness:
    """Draws where the mass of an object is, and the three or four places that it stands on.

    One that could roll, as a mug that lies, lies as it would come to rest without feet.

    Args:
        mesh: The object, m, frame O.
        hulls: Corners (n, 3) m, frame O, of the convex pieces that fill it.
        mass: kg.
        up: (3,), axis of O that points up.
        generator: Source of randomness.

    Raises:
        GeometryError: No lump or no feet were found that leave the object standing.
    """
    for _ in range(_ATTEMPTS):
        p_com, inertia = _with_lump(mesh, hulls, mass, generator)
        if _lies_lowest(mesh, p_com, up):
            return Unevenness(p_com, inertia, _feet(mesh, p_com, up, generator))
    raise GeometryError("no place for a lump was found with which the object would not roll away")


def _lies_lowest(mesh: trimesh.Trimesh, p_com: np.ndarray, up: np.ndarray) -> bool:
    corners, normals = mesh.convex_hull.vertices, mesh.convex_hull.face_normals
    tilts = np.arccos(np.clip(normals @ -up, -1.0, 1.0))
    near = np.vstack([-up, normals[(tilts > _ROUGH) & (tilts < _ROLLS)]])
    heights = ((corners - p_com) @ near.T).max(axis=0)
    return bool(heights[0] < heights.min() + _SAME)


def _with_lump(
    mesh: trimesh.Trimesh, hulls: Sequence[np.ndarray], mass: float, generator: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Centre of mass (3,) m and inertia (3, 3) of a uniform solid, a share of whose mass is a ball somewhere within."""
    solid = mass_properties(mesh, mass=mass)
    extent = float(mesh.extents.mean())
    for _ in range(_ATTEMPTS):
        share, off = generator.uniform(*_LUMP_SHARE), generator.uniform(*_OFF) * extent
        # A place within one of the convex pieces.
        weights = generator.dirichlet(np.ones(4))
        hull = hulls[int(generator.integers(len(hulls)))]
        place = weights @ hull[generator.choice(len(hull), 4, replace=False)]
        away = place - solid.p_com
        if not np.isclose(share * np.linalg.norm(away), off, rtol=0.15):
            continue
        about = mass * (1 - share) * share * (away @ away * np.eye(3) - np.outer(away, away))
        ball = 0.4 * share * mass * _LUMP_RADIUS**2 * np.eye(3)
        inertia = 0.5 * (solid.inertia + solid.inertia.T)
        return solid.p_com + share * away, (1 - share) * inertia + about + ball
    raise GeometryError(f"no place for a lump was found within {len(hulls)} pieces; allowed: a body that has volume")


def _feet(mesh: trimesh.Trimesh, p_com: np.ndarray, up: np.ndarray, generator: np.random.Generator) -> np.ndarray:
    """Feet (n, 3) m, frame O, in whose polygon the centre of mass stands."""
    corners = np.unique(np.asarray(mesh.convex_hull.vertices).round(9), axis=0)
    across, along = _plane(up)
    height = corners @ up
    base = corners[height < height.min() + _BASE]
    flat = np.column_stack([base @ across, base @ along])
    try:
        outline = flat[ConvexHull(flat).vertices]
    except QhullError as error:
        raise GeometryError(f"{len(base)} corners below make no face; allowed: a face to stand on") from error
    com = np.array([p_com @ across, p_com @ along])
    middle = outline.mean(axis=0)
    for _ in range(_ATTEMPTS):
        number = int(generator.integers(_FEET[0], _FEET[1] + 1))
        start = generator.integers(len(outline), size=number)
        share = generator.uniform(size=(number, 1))
        edge = share * outline[start] + (1 - share) * outline[(start + 1) % len(outline)]
        feet = middle + generator.uniform(*_OUTWARDS, (number, 1)) * (edge - middle)
        hull = ConvexHull(feet)
        inside = -(hull.equations[:, :2] @ com + hull.equations[:, 2]).max()
        if len(hull.vertices) == number and inside > _SAFE:
            return feet[:, :1] * across + feet[:, 1:] * along + (height.min() - _FOOT_HEIGHT) * up
    raise GeometryError("no feet were found around the centre of mass; allowed: a face below that is wide enough")


def _plane(up: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two axes (3,) across `up` that make a right-handed frame with it; x and y for z."""
    first = np.array([1.0, 0.0, 0.0]) if abs(up[0]) < 0.9 else np.array([0.0, 1.0, 0.0])
    across = first - (first @ up) * up
    across /= np.linalg.norm(across)
    return across, np.cross(up, across)


def write_with_feet(mesh_path: Path, folder: Path, feet: np.ndarray, up: np.ndarray) -> Path:
    """Write the mesh of an object and discs that stand out as its feet, closed surfaces of their own, with its pieces.

    Args:
        mesh_path: OBJ file, m, frame O; convex pieces may stand in `pieces` beside it.
        folder: Folder of the new file, which has the name of the old one.
        feet: (n, 3) m, frame O, the lowest points.
        up: (3,), axis of O that points up.
    """
    path, text = folder / mesh_path.name, read_text(mesh_path)
    count = sum(line.startswith("v ") for line in text.splitlines())
    turn = np.eye(4)
    turn[:3, :3] = np.column_stack([*_plane(up), up])
    if (beside := mesh_path.parent / BESIDE).is_dir():
        shutil.copytree(beside, folder / BESIDE)
    for k, foot in enumerate(feet):
        disc = trimesh.creation.cylinder(_FOOT_RADIUS, _FOOT_LENGTH, sections=12)
        disc.apply_transform(turn)
        disc.apply_translation(foot + 0.5 * _FOOT_LENGTH * up)
        text += f"o foot_{k}\n" + "".join(f"v {x:.9g} {y:.9g} {z:.9g}\n" for x, y, z in disc.vertices)
        text += "".join(f"f {a} {b} {c}\n" for a, b, c in disc.faces + 1 + count)
        count += len(disc.vertices)
        if beside.is_dir():
            # They are found beside the mesh, and would stand on a flat face without these.
            disc.export(folder / BESIDE / f"foot_{k}.obj")
    path.write_text(text, encoding="utf-8")
    return path
