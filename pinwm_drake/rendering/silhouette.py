# SPDX-License-Identifier: MIT
"""The outline of a mesh, also from where there is no image."""

import numpy as np
import torch
import trimesh
from torch import Tensor

from pinwm_drake.rendering.camera import Camera
from pinwm_drake.rendering.kernels.triangles import mark_triangles
from pinwm_drake.spatial.poses import Pose, transform
from pinwm_drake.spatial.rotations import quaternion_exp, quaternion_multiply, rotate

_NEAR = 1e-3  # m; what is closer to the camera, or behind it, is not projected


def coverage(mesh: trimesh.Trimesh, camera: Camera, X_CO: Pose) -> Tensor:
    """Mask of the pixels whose centres a mesh covers, 0 or 1.

    Args:
        mesh: surface in O, m, all of it in front of the camera.
        camera: camera with intrinsics (4,).
        X_CO: pose of the object in the camera frame: q (4,), p (3,), m.

    Returns:
        (H, W) float32, 0 or 1.
    """
    corners = transform(X_CO, torch.from_numpy(np.array(mesh.vertices))).numpy()
    fx, fy, cx, cy = camera.intrinsics.tolist()
    at = corners[:, :2] / corners[:, 2:] * [fx, fy] + [cx, cy]
    marked = np.zeros((camera.height, camera.width), np.float32)
    mark_triangles(at[mesh.faces], marked)
    return torch.from_numpy(marked)


def silhouette(mesh: trimesh.Trimesh, camera: Camera, X_CO: Pose) -> np.ndarray | None:
    """Mask of the pixels that a mesh covers, or None where it reaches behind the camera.

    Args:
        mesh: surface in O, m.
        camera: camera with intrinsics (4,).
        X_CO: pose of the object in the camera frame: q (4,), p (3,), m.

    Returns:
        (H, W) bool; None where a part of the mesh is behind the camera, or less than 1 mm in front of it.
    """
    depths = transform(X_CO, torch.from_numpy(np.array(mesh.vertices)))[:, 2]
    return None if float(depths.min()) < _NEAR else coverage(mesh, camera, X_CO).numpy() > 0


def between_views(mesh: trimesh.Trimesh, X_CO: Pose, spread: float, generator: np.random.Generator) -> Pose:
    """Return a pose near a given one: the object turned at random about its middle.

    Args:
        mesh: surface in O, m.
        X_CO: pose before: q (4,), p (3,), m.
        spread: standard deviation of the rotation vector's parts, rad.
        generator: draws it.

    Returns:
        X_CO afterwards.
    """
    middle = torch.from_numpy(np.mean(mesh.bounds, 0))
    q_CO = quaternion_multiply(X_CO.q, quaternion_exp(torch.from_numpy(generator.normal(0.0, spread, 3))))
    return Pose(q_CO, transform(X_CO, middle) - rotate(q_CO, middle))
