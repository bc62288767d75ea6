# SPDX-License-Identifier: MIT
"""Triangle mesh of surfels, for viewers that draw meshes."""

import math
from dataclasses import dataclass

import numpy as np

from pinwm_drake.rendering.harmonics import Y0
from pinwm_drake.rendering.surfels import Surfels
from pinwm_drake.spatial.rotations import normalize_quaternion, quaternion_to_matrix

CORNERS = 8
# Edge of the ellipse, in scales: there a Gaussian is down to half of its height.
_EDGE = math.sqrt(2 * math.log(2))
_FAINT = 0.3  # surfels of less opacity are left out, unless there are no others


@dataclass(frozen=True, eq=False)
class SurfelMesh:
    """Mesh with an octagon for each surfel that is not faint."""

    vertices: np.ndarray  # (8 n, 3) float32 [m], object frame O
    normals: np.ndarray  # (8 n, 3) float32, unit, O
    colours: np.ndarray  # (8 n, 3) float32, sRGB in [0, 1]: the mean of a surfel's colour over all directions
    faces: np.ndarray  # (6 n, 3) uint32, counter-clockwise around the normal

    @classmethod
    def from_surfels(cls, surfels: Surfels) -> "SurfelMesh":
        """Mesh of surfels, one or more with one set of colours, each cut off where it is down to half of its height."""
        opacity = surfels.logit_opacity.detach().sigmoid().numpy()
        kept = opacity >= min(_FAINT, opacity.max(initial=0))
        R_OS = quaternion_to_matrix(normalize_quaternion(surfels.q_OS.detach().double())).numpy()[kept]
        scale = _EDGE * surfels.log_scale.detach().double().exp().numpy()[kept]
        angles = 2 * math.pi * (np.arange(CORNERS) + 0.5) / CORNERS
        circle = np.stack((np.cos(angles), np.sin(angles)), axis=-1)
        offsets = np.einsum("nij,nkj->nki", R_OS[:, :, :2], scale[:, None] * circle)
        vertices = surfels.p_OS.detach().double().numpy()[kept][:, None] + offsets
        colour = np.clip(0.5 + Y0 * surfels.sh.detach().numpy()[kept, 0], 0, 1)
        fan = np.array([(0, k, k + 1) for k in range(1, CORNERS - 1)])
        faces = fan + CORNERS * np.arange(len(vertices))[:, None, None]
        return cls(
            vertices=vertices.reshape(-1, 3).astype(np.float32),
            normals=np.repeat(R_OS[:, :, 2], CORNERS, axis=0).astype(np.float32),
            colours=np.repeat(colour, CORNERS, axis=0).astype(np.float32),
            faces=faces.reshape(-1, 3).astype(np.uint32),
        )
