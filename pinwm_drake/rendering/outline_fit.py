# SPDX-License-Identifier: MIT
"""Fit of a mesh to masks: its vertices move until it covers the pixels that the object does.

The misfit is the difference between the mask that the mesh has in a view and the view's own, blurred by a few pixels,
so that it changes evenly while an edge passes over them. Its derivatives are differences: masks of a mesh are cheap.
Gauss-Newton's steps (Nocedal and Wright, "Numerical Optimization", 2006, section 10.3) begin with small pictures.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
import trimesh
from scipy.ndimage import gaussian_filter

from pinwm_drake.errors import ParameterError
from pinwm_drake.geometry.meshes import half_diagonal
from pinwm_drake.rendering.silhouette import silhouette
from pinwm_drake.rendering.views import View

# Longer side of the mesh's box in the pictures, px, and steps at that size at the most.
_SIZES = ((50.0, 6), (100.0, 4))
_BLUR = 2.0  # px, standard deviation; every second pixel counts, as neighbours tell the same
_ALIKE = 50.0  # times the mean square of the misfit, that its variance counts as: what is blurred is alike around
_PRIOR = 0.05  # of the diagonal of the mesh, standard deviation of a vertex from where it is given
_LONGEST = 3.0  # px, by which a step moves a vertex along an axis at the most
MOST_VERTICES = 64  # at places of their own: of more, outlines show too few
_MARGIN = 8  # px, around the object
_LEAST_GAIN = 0.05  # of the mean square of the misfit, below which a size is done with


@dataclass(frozen=True, eq=False)
class OutlineFit:
    """Mesh that was fitted to masks."""

    mesh: trimesh.Trimesh  # Vertices moved, faces as they were; m, frame O
    before: float  # Share of the masks' pixels by which the given mesh's differ: more and less than the object together
    after: float  # That of the fitted mesh
    moved: np.ndarray  # (n,) m, distances by which its vertices moved


def fit_outline(
    views: Sequence[View], mesh: trimesh.Trimesh, *, progress: Callable[[float, float], None] = lambda share, loss: None
) -> OutlineFit:
    """Move the vertices of a mesh until its outlines are those of masks.

    What no outline shows, such as the bottom of a hollow, stays as it is given. Vertices at one place stay together.

    Args:
        views: Posed images with masks, in which nothing hides the object.
        mesh: Its surface as it is given, m, frame O; at most 64 vertices.
        progress: Called after each step with the share of the work that is done, and the mean square of the misfit.

    Returns:
        The fitted mesh, and how well it fits.

    Raises:
        ParameterError: There is no view, a mask is empty, or the mesh has more vertices.
    """
    if not views or not all(bool(view.mask.any()) for view in views):
        raise ParameterError(f"views: got {len(views)}; allowed: one or more, with the object in each mask")
    given, faces = np.array(mesh.vertices, float), np.array(mesh.faces)
    places, corners = np.unique(given, axis=0, return_inverse=True)
    if len(places) > MOST_VERTICES:
        raise ParameterError(f"mesh: got {len(places)} vertices; allowed: at most {MOST_VERTICES}")
    corners = corners.reshape(-1)
    start = places.copy()
    deviation = _PRIOR * 2.0 * half_diagonal(mesh)
    own, steps = _Masks.of(views, given, faces), sum(number for _, number in _SIZES)
    done = 0
    for size, number in _SIZES:
        masks = _Masks.of(views, given, faces, size)
        misfit = masks.misfit(places[corners])
        for k in range(number):
            places, misfit, gain = _step(masks, start, places, corners, misfit, deviation)
            progress((done + k + 1) / steps, float(np.mean(misfit**2)))
            if gain < _LEAST_GAIN:
                break
        done += number
    fitted = places[corners]
    before, after = own.differing(given), own.differing(fitted)
    if after >= before:
        fitted, after = given, before
    found = trimesh.Trimesh(fitted, faces, process=False)
    return OutlineFit(found, before, after, np.linalg.norm(fitted - given, axis=1))


@dataclass(frozen=True, eq=False)
class _Masks:
    """Views of one size, and the faces of the mesh in them."""

    views: list[View]
    faces: np.ndarray
    pixel: float  # m, of the object in them

    @classmethod
    def of(cls, views: Sequence[View], vertices: np.ndarray, faces: np.ndarray, size: float = math.inf) -> "_Masks":
        """Return the parts of views in which a mesh is, whose longer side has at most so many px."""
        parts = [view.close_up(torch.from_numpy(vertices), _MARGIN, size) for view in views]
        pixels = [float(part.X_CO.p[2] / part.camera.intrinsics[:2].mean()) for part in parts]
        return cls(parts, faces, float(np.median(pixels)))

    def covered(self, vertices: np.ndarray, view: View) -> np.ndarray:
        """Mask (height, width) of the mesh; empty where it reaches behind the camera."""
        found = silhouette(trimesh.Trimesh(vertices, self.faces, process=False), view.camera, view.X_CO)
        return np.zeros((view.camera.height, view.camera.width), bool) if found is None else found

    def misfit(self, vertices: np.ndarray) -> np.ndarray:
        """Blurred differences of the masks, of all views one after the other."""
        parts = []
        for view in self.views:
            more = self.covered(vertices, view).astype(np.float32) - view.mask.numpy().astype(np.float32)
            parts.append(gaussian_filter(more, _BLUR)[::2, ::2].ravel())
        return np.concatenate(parts)

    def differing(self, vertices: np.ndarray) -> float:
        """Share of the masks' pixels by which the mesh's differ."""
        differing = sum(int((self.covered(vertices, view) != view.mask.numpy()).sum()) for view in self.views)
        return differing / sum(int(view.mask.sum()) for view in self.views)


def _step(
    masks: _Masks,
    start: np.ndarray,
    places: np.ndarray,
    corners: np.ndarray,
    misfit: np.ndarray,
    deviation: float,
) -> tuple[np.ndarray, np.ndarray, float]:
    """Places (h, 3) of vertices and misfit after a step, and the share of the misfit's square that it gained.

    Places were given at `start`, to a standard deviation; `corners` (n,) are the numbers of the mesh's vertices' ones.
    """
    J = np.empty((len(misfit), places.size), np.float32)
    for column in range(places.size):
        change = np.zeros_like(places)
        change.flat[column] = masks.pixel
        there, back = masks.misfit((places + change)[corners]), masks.misfit((places - change)[corners])
        J[:, column] = (there - back) / (2.0 * masks.pixel)
    variance = _ALIKE * float(np.mean(misfit**2)) + 1e-8
    H = J.T @ J / variance + np.eye(places.size) / deviation**2
    gradient = J.T @ misfit / variance + (places - start).ravel() / deviation**2
    step = np.clip(-np.linalg.solve(H, gradient), -_LONGEST * masks.pixel, _LONGEST * masks.pixel)
    for share in (1.0, 0.5, 0.25):
        new = places + share * step.reshape(places.shape)
        found = masks.misfit(new[corners])
        gain = 1.0 - float(np.mean(found**2)) / max(float(np.mean(misfit**2)), 1e-12)
        if gain > 0.0:
            return new, found, gain
    return places, misfit, 0.0
