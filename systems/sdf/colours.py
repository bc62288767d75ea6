# SPDX-License-Identifier: MIT
"""Mesh of a twin in the colours of its surfels, for renderers that know meshes only."""

import functools
import warnings

import numpy as np
import torch
import trimesh
from scipy.cluster.vq import kmeans2
from scipy.spatial import cKDTree
from scipy.special import expit
from torch import Tensor

from pinwm_drake.rendering.harmonics import harmonics
from pinwm_drake.rendering.surfels import Surfels
from pinwm_drake.systems.sdf.collision import divided

# Triangles along the object's longest side, at least, where that makes no more than so many in all.
_STEPS, _TRIANGLES = 40, 20000
_COLOURS = 32
_NEAREST = 8  # surfels that a triangle takes its colour from
_MINIMUM = 1e-3  # m, added to distances: what is nearer than that counts alike


def coloured_mesh(mesh: trimesh.Trimesh, surfels: Surfels, mtl_name: str) -> tuple[str, str]:
    """Return a mesh whose small triangles have the colours of the surfels near them.

    Args:
        mesh: Mesh of the object, m, frame O.
        surfels: Appearance of the object, frame O; each is taken as it looks from straight above the triangle.
        mtl_name: Name of the file of colours.

    Returns:
        The texts of the OBJ file, with a normal for each face, and of the MTL file, in at most 32 colours.
    """
    return _coloured(np.asarray(mesh.triangles, float).tobytes(), _parts(surfels), mtl_name)


@functools.lru_cache(maxsize=16)
def _coloured(corners: bytes, parts: tuple[tuple[tuple[int, ...], bytes], ...], mtl_name: str) -> tuple[str, str]:
    """`coloured_mesh` of triangles, and of centres, opacities and colours: each diagram of a twin asks for it."""
    triangles, normals, colours = _samples(corners, parts)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # fewer colours than that are no harm
        palette, owner = kmeans2(colours, _COLOURS, minit="++", rng=np.random.default_rng(0))
    lines = [f"mtllib {mtl_name}", _rows("v", triangles.reshape(-1, 3)), _rows("vn", normals)]
    for colour in np.unique(owner):
        lines.append(f"usemtl colour_{colour}")
        for k in np.flatnonzero(owner == colour) + 1:
            lines.append(f"f {3 * k - 2}//{k} {3 * k - 1}//{k} {3 * k}//{k}")
    plain = "Ka 0 0 0\nKs 0 0 0\nillum 1\n"
    materials = [f"newmtl colour_{k}\n{_rows('Kd', palette[k : k + 1])}\n{plain}" for k in np.unique(owner)]
    return "\n".join(lines) + "\n", "\n".join(materials)


def surface_samples(mesh: trimesh.Trimesh, surfels: Surfels) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return small triangles of a mesh in the colours of the surfels near them; arguments as for `coloured_mesh`.

    Returns:
        Corners (n, 3, 3) m and normals (n, 3), frame O; colours (n, 3), sRGB from 0 to 1.
    """
    return _samples(np.asarray(mesh.triangles, float).tobytes(), _parts(surfels))


def _parts(surfels: Surfels) -> tuple[tuple[tuple[int, ...], bytes], ...]:
    """Centres, opacities and colours as shapes and bytes, which a cache can tell apart."""
    learned = (surfels.p_OS, surfels.logit_opacity, surfels.sh)
    return tuple((one.shape, one.detach().double().numpy().tobytes()) for one in learned)


@functools.lru_cache(maxsize=16)
def _samples(
    corners: bytes, parts: tuple[tuple[tuple[int, ...], bytes], ...]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """`surface_samples` of triangles, and of centres, opacities and colours: each diagram of a twin asks for it."""
    whole = np.frombuffer(corners).reshape(-1, 3, 3)
    p_OS, logit_opacity, sh = (np.frombuffer(values).reshape(shape) for shape, values in parts)
    extent = float(np.ptp(whole, axis=(0, 1)).max())
    longest_edge = extent / _STEPS
    while len(triangles := divided(whole, longest_edge)) > _TRIANGLES and longest_edge < extent:
        longest_edge *= 1.5
    across = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    normals = across / np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-300)
    return triangles, normals, _colours(triangles.mean(axis=1), normals, p_OS, logit_opacity, torch.tensor(sh))


def _colours(
    middles: np.ndarray, normals: np.ndarray, p_OS: np.ndarray, logit_opacity: np.ndarray, sh: Tensor
) -> np.ndarray:
    """Colours (n, 3), sRGB from 0 to 1, of points (n, 3) [m] with outward normals (n, 3); the rest as in `Surfels`."""
    count = min(_NEAREST, len(p_OS))
    distance, index = cKDTree(p_OS).query(middles, k=count)
    distance, index = distance.reshape(len(middles), count), index.reshape(len(middles), count)
    sh = sh if sh.ndim == 3 else sh.mean(dim=0)
    basis = harmonics(-torch.from_numpy(normals), round(sh.shape[1] ** 0.5) - 1)
    seen = (0.5 + torch.einsum("nk,njkc->njc", basis, sh[torch.from_numpy(index)])).clamp(0.0, 1.0).numpy()
    opacity = expit(logit_opacity)[index]
    weight = opacity / (distance + _MINIMUM) ** 4
    return (weight[..., None] * seen).sum(axis=1) / np.maximum(weight.sum(axis=1), 1e-300)[:, None]


def _rows(keyword: str, values: np.ndarray) -> str:
    """Lines of a keyword and three numbers each, of values (n, 3); formatted all at once, as there are thousands."""
    return "\n".join([f"{keyword} %.6g %.6g %.6g"] * len(values)) % tuple((values + 0.0).ravel().tolist())
