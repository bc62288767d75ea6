# SPDX-License-Identifier: MIT
"""Discs of surfels, for viewers that draw triangles with textures."""

import math
from dataclasses import dataclass

import numpy as np

from pinwm_drake.rendering.harmonics import Y0
from pinwm_drake.rendering.surfels import Surfels
from pinwm_drake.report.gltf import Sheet
from pinwm_drake.spatial.rotations import normalize_quaternion, quaternion_to_matrix

CORNERS = 12  # of a core
_HIDES = 0.5  # alpha from which on a disc hides what is behind it
_REACH = 2.5  # half of a rim's side, in scales
_PIXELS = 64  # of the texture of a Gaussian
_FAINT = 0.05  # surfels of less opacity are left out, unless there are no others


@dataclass(frozen=True, eq=False)
class SurfelMesh:
    """Mesh of discs for renderers that sort nothing: cores that hide what is behind them, and soft rims over all.

    A core is a polygon of 12 corners where a surfel's alpha is half or more; there is none where it is less everywhere.
    A rim is a square, on which `GAUSSIAN` is to be painted, for each surfel that is not faint.
    """

    core_vertices: np.ndarray  # (12 k, 3) float32 [m], object frame O
    core_colours: np.ndarray  # (12 k, 3) float32 in [0, 1]: sRGB, the mean over all directions
    core_faces: np.ndarray  # (10 k, 3) uint32, counter-clockwise around the normal
    rim_vertices: np.ndarray  # (4 n, 3) float32 [m], O
    rim_colours: np.ndarray  # (4 n, 4) float32 in [0, 1]: sRGB and opacity
    rim_uv: np.ndarray  # (4 n, 2) float32, places in the texture
    rim_faces: np.ndarray  # (2 n, 3) uint32, counter-clockwise around the normal

    @classmethod
    def from_surfels(cls, surfels: Surfels) -> "SurfelMesh":
        """Mesh of surfels, one or more with one set of colours."""
        opacity = surfels.logit_opacity.detach().double().sigmoid().numpy()
        kept = opacity >= min(_FAINT, opacity.max(initial=0))
        opacity, p_OS = opacity[kept], surfels.p_OS.detach().double().numpy()[kept]
        R_OS = quaternion_to_matrix(normalize_quaternion(surfels.q_OS.detach().double())).numpy()[kept]
        axes = R_OS[:, :, :2] * surfels.log_scale.detach().double().exp().numpy()[kept][:, None]
        colour = np.clip(0.5 + Y0 * surfels.sh.detach().numpy()[kept, 0], 0, 1)
        angles = 2 * math.pi * (np.arange(CORNERS) + 0.5) / CORNERS
        circle, square = (
            np.stack((np.cos(angles), np.sin(angles)), axis=-1),
            np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]),
        )
        hides = opacity > _HIDES
        radius = np.sqrt(2 * np.log(np.where(hides, opacity, 1) / _HIDES))
        core_vertices, core_faces = _polygons(p_OS[hides], radius[hides, None, None] * axes[hides], circle)
        rim_vertices, rim_faces = _polygons(p_OS, _REACH * axes, square)
        return cls(
            core_vertices=core_vertices,
            core_colours=np.repeat(colour[hides], CORNERS, axis=0).astype(np.float32),
            core_faces=core_faces,
            rim_vertices=rim_vertices,
            rim_colours=np.repeat(np.column_stack((colour, opacity)), 4, axis=0).astype(np.float32),
            rim_uv=np.tile((0.5 + 0.5 * square).astype(np.float32), (len(p_OS), 1)),
            rim_faces=rim_faces,
        )

    def sheets(self) -> list[Sheet]:
        """Cores and rims as sheets."""
        rims = Sheet(
            self.rim_vertices, self.rim_faces, linear(self.rim_colours), uv=self.rim_uv, texture=GAUSSIAN, blend=True
        )
        cores = Sheet(self.core_vertices, self.core_faces, linear(self.core_colours))
        return [cores, rims] if len(self.core_faces) else [rims]


def _polygons(p_OS: np.ndarray, axes: np.ndarray, shape: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Corners (c n, 3) and triangles ((c - 2) n, 3) of polygons.

    Args:
        p_OS: (n, 3) m, their middles.
        axes: (n, 3, 2) m, their half axes.
        shape: (c, 2), corners in units of the half axes, counter-clockwise.
    """
    vertices = p_OS[:, None] + np.einsum("nij,kj->nki", axes, shape)
    count = len(shape)
    fan = np.array([(0, k, k + 1) for k in range(1, count - 1)])
    faces = fan + count * np.arange(len(p_OS))[:, None, None]
    return vertices.reshape(-1, 3).astype(np.float32), faces.reshape(-1, 3).astype(np.uint32)


def gaussian_texture() -> np.ndarray:
    """Texture (64, 64, 4) uint8, white, whose alpha is a Gaussian that ends at the edge of the disc."""
    at = _REACH * (2 * (np.arange(_PIXELS) + 0.5) / _PIXELS - 1)
    square = at**2 + at[:, None] ** 2
    end = math.exp(-0.5 * _REACH**2)
    alpha = np.clip((np.exp(-0.5 * square) - end) / (1 - end), 0, 1)
    picture = np.full((_PIXELS, _PIXELS, 4), 255, np.uint8)
    picture[..., 3] = np.rint(255 * alpha)
    return picture


GAUSSIAN = gaussian_texture()


def linear(colours: np.ndarray) -> np.ndarray:
    """Return colours (n, 3) in sRGB, or (n, 4) with an opacity, 0 to 1, as intensities, which renderers mix."""
    srgb = colours[:, :3]
    found = np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
    return np.column_stack((found, colours[:, 3:])).astype(np.float32)
