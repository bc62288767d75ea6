# SPDX-License-Identifier: MIT
"""Visibility of a mesh's patches in a view, and their colours there."""

import numpy as np
import torch
import trimesh

from pinwm_drake.rendering.patches import Patches
from pinwm_drake.rendering.render import render
from pinwm_drake.rendering.surfels import Surfels
from pinwm_drake.rendering.views import View, project
from pinwm_drake.spatial.poses import inverse
from pinwm_drake.spatial.rotations import matrix_to_quaternion

_MAP = 256  # px, the longer side of a depth map
# A patch is seen where it lies no further behind the depth map than this, in pixels of that map.
_BEHIND = 2.0
# Steeper than this, as the cosine of the angle of sight and normal, nothing counts as seen.
_STEEPEST = 0.05


def as_surfels(patches: Patches, opacity: float) -> Surfels:
    """One black surfel of degree 0 for each patch."""
    R_OS = np.stack([patches.tangents, np.cross(patches.normals, patches.tangents), patches.normals], -1)
    return Surfels(
        p_OS=torch.from_numpy(patches.points).float(),
        q_OS=matrix_to_quaternion(torch.from_numpy(R_OS)).float(),
        log_scale=torch.from_numpy(patches.scales).log().float(),
        logit_opacity=torch.full((patches.number,), opacity).logit(),
        sh=torch.zeros(patches.number, 1, 3),
    )


class Sight:
    """Sight of a mesh in one view, by the depths that surfels all over its surface make up."""

    def __init__(self, view: View, mesh: trimesh.Trimesh, cover: Patches, num_threads: int | None = None) -> None:
        """Render the depths of the mesh (O, m), which is in front of the view's camera, with patches all over it."""
        corners = torch.from_numpy(np.array(mesh.vertices))
        x, y, width, height = view.object_box(corners, 2)
        camera = view.camera.cropped(x, y, width, height)
        camera = camera.scaled(_MAP / max(width, height))
        with torch.no_grad():
            images = render(as_surfels(cover, 0.99), camera, view.X_CO, num_threads=num_threads)
        assert images.depth is not None
        depth = torch.where(images.alpha > 0.5, images.depth / images.alpha.clamp_min(0.5), torch.inf)
        self._depth = depth[0].numpy()
        self._view, self._camera = view, camera
        self._distance = float(view.project(corners)[1].mean())
        self.pixel = self._distance / float(view.camera.intrinsics[0])  # m, on the object

    def cosines(self, patches: Patches) -> np.ndarray:
        """Cosines (n,) of the angle between normal and direction to the camera where a patch is seen; 0 elsewhere."""
        points = torch.from_numpy(patches.points)
        to_camera = inverse(self._view.X_CO).p.numpy() - patches.points
        cosine = np.sum(patches.normals * to_camera, 1) / np.maximum(np.linalg.norm(to_camera, axis=1), 1e-9)
        at, z = project(self._camera, self._view.X_CO, points)
        row, column, inside = _pixels(at.numpy(), z.numpy(), self._depth.shape)
        tolerance = _BEHIND * self._distance / float(self._camera.intrinsics[0]) / np.maximum(cosine, _STEEPEST)
        near = z.numpy() <= self._depth[row, column] + tolerance
        return np.where(inside & near & (cosine > _STEEPEST), cosine, 0.0)

    def colors(self, patches: Patches) -> tuple[np.ndarray, np.ndarray]:
        """Colours (n, 3) of the image at the patches, and flags (n,): the mask is there."""
        at, z = self._view.project(torch.from_numpy(patches.points))
        row, column, inside = _pixels(at.numpy(), z.numpy(), tuple(self._view.mask.shape))
        return self._view.image.numpy()[row, column], inside & self._view.mask.numpy()[row, column]


def _pixels(at: np.ndarray, z: np.ndarray, size: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rows and columns of the pixels of points, moved into the image, and flags: the point was inside and ahead."""
    height, width = size
    with np.errstate(invalid="ignore"):
        inside = (z > 0.0) & (at >= 0.0).all(1) & (at[:, 0] < width) & (at[:, 1] < height)
    whole = np.where(inside[:, None], at, 0.0).astype(int)
    return whole[:, 1], whole[:, 0], inside
