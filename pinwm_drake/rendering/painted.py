# SPDX-License-Identifier: MIT
"""Surfels of a coloured mesh: an appearance that comes from a model and not from a video."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
import trimesh
from scipy.spatial import cKDTree

from pinwm_drake.errors import InputError, RenderingError
from pinwm_drake.geometry.meshes import require_extent
from pinwm_drake.reading.meshes import read_scene
from pinwm_drake.rendering.harmonics import Y0
from pinwm_drake.rendering.patches import EVEN, Patches, crease_ends, farthest, keep_inside, line_creases, spread
from pinwm_drake.rendering.surfels import Surfels
from pinwm_drake.rendering.visibility import as_surfels

# Samples of the surface for each surfel that is placed, share of the surfels that line creases, and opacity of each.
_CANDIDATES, _CREASE_SHARE, _OPACITY = 2, 0.3, 0.99
# The surface is closed by so much wider surfels than evenly spread ones are in a fit, which has no need of that.
_WIDER = 1.4
# The step, which decides how narrow the surfels along creases are and how far from them, goes into the object 75 times.
_STEPS = 75.0
# Rows along creases: further in, and narrower for that, than those that a fit starts from and then moves. So a
# silhouette is neither wider nor narrower than the mesh's. In units of what `line_creases` makes.
_FURTHER, _NARROWER = 1.4, 0.6
# The least distance of surfels from any crease, in steps, of the rows and of the others.
_ROW_GAP, _FILL_GAP = 0.9, 2.0
# Where the tip of a surfel along a crease, so many scales from its middle, is beside the mesh, it gets shorter.
_TIP, _SHORTER = 1.5, 0.5
_FEWEST = 100
_GREY = 0.6  # sRGB
_JOIN = 1e-8  # m: corners nearer to each other are one
_ROWS = 64  # points that are looked up in the faces at once


def painted_surfels(visual_path: Path, number: int = 2500, *, seed: int = 0) -> Surfels:
    """Opaque surfels all over a coloured mesh, flat on it, each in the diffuse colour of the face that it lies on.

    Colours are the material's numbers as they stand (Kd), which is what a renderer shows of them in full light: sRGB
    as in images. Rows of narrow surfels line the creases, which makes outlines sharp; the others are spread evenly.

    Args:
        visual_path: An OBJ file whose faces have materials with a Kd in an MTL file, m, object frame O.
        number: Number of surfels at the most, 100 or more.
        seed: Seed of the places; the same seed gives the same surfels.

    Returns:
        The surfels, of degree 0, frame O.

    Raises:
        InputError: The file is missing, cannot be read, has no faces of any area, is not of 1 mm to 5 m, has a face
            without a material, or a material with a texture.
        RenderingError: The number is out of range.
    """
    mesh, colours = _read(visual_path)
    return _over(mesh, colours, number, seed)


def plain_surfels(mesh: trimesh.Trimesh, number: int = 1000, *, seed: int = 0) -> Surfels:
    """Opaque grey surfels all over a mesh [m], for an object whose appearance is not known; see `painted_surfels`."""
    return _over(mesh, np.full((len(mesh.faces), 3), _GREY), number, seed)


def _over(mesh: trimesh.Trimesh, colours: np.ndarray, number: int, seed: int) -> Surfels:
    """Surfels all over a mesh [m] in the colours (m, 3) of its faces."""
    if number < _FEWEST:
        raise RenderingError(f"painted_surfels got number={number}; allowed: 100 or more")
    generator = np.random.default_rng(seed)
    step = float(mesh.extents.max()) / _STEPS
    creases = cKDTree(_crease_points(mesh, 0.5 * step))
    wanted = int(_CREASE_SHARE * number)
    rows = line_creases(mesh, _FURTHER * step, wanted, lambda patches: np.ones(patches.number, bool))
    # On a narrow face, such as a rim, the second row of one crease would lie on the other.
    rows = rows.select(creases.query(rows.points)[0] > _ROW_GAP * step)
    rows = rows.select(generator.permutation(rows.number)[:wanted])
    rows.scales[:, 1] *= _NARROWER
    tips = np.stack([-1.0, 1.0])[:, None, None] * (_TIP * rows.scales[:, :1] * rows.tangents) + rows.points
    over = (_faces_under(mesh, tips.reshape(-1, 3))[1].reshape(2, -1) > 0.1 * step).any(axis=0)
    rows.scales[over, 0] *= _SHORTER
    fill = spread(mesh, _CANDIDATES * number, generator)
    inside = creases.query(fill.points)[0] > _FILL_GAP * step
    fill = fill.select(inside if inside.sum() >= number else np.ones(fill.number, bool))
    chosen, gap = farthest(fill.points.astype(np.float32), rows.points, number - rows.number)
    fill = fill.select(chosen)
    fill.scales[:] = _WIDER * EVEN * max(gap, 0.5 * step)
    keep_inside(fill, mesh)
    patches = Patches.join(rows, fill)
    sh = torch.from_numpy((colours[_faces_under(mesh, patches.points)[0]] - 0.5) / Y0).float()
    return replace(as_surfels(patches, _OPACITY), sh=sh[:, None])


def _read(path: Path) -> tuple[trimesh.Trimesh, np.ndarray]:
    """Return the surface, with corners joined where they meet, and the colour of each face (m, 3), 0 to 1."""
    allowed = "an OBJ file of coloured faces, with its MTL file beside it"
    if not path.is_file():
        raise InputError(path, value="no such file", allowed=allowed)
    scene = read_scene(path, allowed)
    corners: list[np.ndarray] = []
    faces, colours, count = [], [], 0
    for part in scene.geometry.values():
        if len(getattr(part, "faces", ())) == 0:  # points, or lines of two corners
            continue
        material = getattr(part.visual, "material", None)
        if material is None or material.name in (None, ""):
            raise InputError(path, value="faces without a material", allowed=allowed)
        if getattr(material, "image", None) is not None:
            raise InputError(path, value=f"material {material.name} with a texture", allowed="materials of one colour")
        faces.append(np.asarray(part.faces) + count)
        corners.append(np.asarray(part.vertices))
        count += len(corners[-1])
        colours.append(np.repeat(np.asarray(material.diffuse, float)[None, :3] / 255.0, len(part.faces), axis=0))
    if not faces:
        raise InputError(path, value="no faces", allowed=allowed)
    require_extent(path, np.concatenate(corners))
    _, first, same = np.unique(
        np.round(np.concatenate(corners) / _JOIN), axis=0, return_index=True, return_inverse=True
    )
    mesh = trimesh.Trimesh(np.concatenate(corners)[first], same.ravel()[np.concatenate(faces)], process=False)
    if not mesh.area > 0.0:
        raise InputError(path, value="faces without area", allowed=allowed)
    return mesh, np.concatenate(colours)


def _crease_points(mesh: trimesh.Trimesh, step: float) -> np.ndarray:
    """Points (n, 3) [m] along the creases of a mesh, `step` [m] or less apart."""
    ends = crease_ends(mesh)[0]
    counts = np.ceil(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1) / step).astype(int) + 1
    points = [np.linspace(start, end, count) for (start, end), count in zip(ends, counts, strict=True)]
    return np.concatenate([np.zeros((0, 3)), *points])


def _faces_under(mesh: trimesh.Trimesh, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Faces (n,) int that points (n, 3) [m] lie on, and the distances (n,) [m] of the points from them."""
    triangles, normals = np.asarray(mesh.triangles), np.asarray(mesh.face_normals)
    inward = np.cross(normals[:, None], np.roll(triangles, -1, axis=1) - triangles)
    inward /= np.maximum(np.linalg.norm(inward, axis=2, keepdims=True), 1e-12)
    # Signed distances to a face's plane and to its three edges, as p @ along - at.
    along = np.concatenate([normals[:, None], inward], axis=1).transpose(1, 2, 0)
    at = np.einsum("kcf,kcf->kf", along, np.concatenate([triangles[:, :1], triangles], axis=1).transpose(1, 2, 0))
    along, at, points = (np.ascontiguousarray(array, np.float32) for array in (along, at, points))
    found, beside = [], []
    for part in np.split(points, range(_ROWS, len(points), _ROWS)):
        plane, *edges = (part @ direction - offset for direction, offset in zip(along, at, strict=True))
        gap = np.maximum(np.abs(plane), -np.minimum(np.minimum(*edges[:2]), edges[2]))
        found.append(np.argmin(gap, axis=1))
        beside.append(np.min(gap, axis=1))
    return np.concatenate(found), np.concatenate(beside)
