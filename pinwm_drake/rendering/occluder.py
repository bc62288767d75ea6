# SPDX-License-Identifier: MIT
"""Depths of a small mesh in front of the cameras: what hides the object behind the pusher."""

import numpy as np
import torch

from pinwm_drake.errors import RenderingError
from pinwm_drake.rendering.camera import Camera
from pinwm_drake.rendering.kernels.triangles import fill_depths
from pinwm_drake.threads import available, share

_WORTH_THREADS = 8  # views


def mesh_depth(
    vertices_C: np.ndarray | torch.Tensor, faces: np.ndarray, camera: Camera, near: float = 0.01
) -> np.ndarray:
    """Depths of a closed mesh in V cameras, at the centre of each pixel.

    Only the pixels of the mesh's box are visited, so a small mesh costs little in a large image.

    Args:
        vertices_C: (V, n, 3), corners in the camera frame (OpenCV axes) of each view, m.
        faces: (m, 3) int, corners of each triangle, of either orientation.
        camera: Camera with intrinsics (4,) or (V, 4).
        near: Least distance along the camera's axis that is seen, m, above 0.

    Returns:
        (V, H, W) float32: distance along the camera's axis, m; inf where the mesh is not.

    Raises:
        RenderingError: Shapes do not fit, a face names a corner that is not there, or `near` is not above 0.

    Source:
        Olano and Greer, "Triangle Scan Conversion using 2D Homogeneous Coordinates", 1997: edges are planes through
        the camera's centre, so that a triangle that reaches behind the camera needs no clipping.
    """
    corners = np.ascontiguousarray(vertices_C, np.float64)
    triangles = np.ascontiguousarray(faces, np.int64)
    if corners.ndim != 3 or corners.shape[2] != 3 or triangles.ndim != 2 or triangles.shape[1] != 3:
        raise RenderingError(f"vertices, faces are {corners.shape}, {triangles.shape}; allowed: (V, n, 3), (m, 3)")
    if triangles.size and not 0 <= triangles.min() <= triangles.max() < corners.shape[1]:
        raise RenderingError(
            f"faces name corners {triangles.min()} to {triangles.max()}; allowed: 0 to {corners.shape[1] - 1}"
        )
    if not near > 0.0:
        raise RenderingError(f"near is {near}; allowed: above 0 m")
    intrinsics = np.atleast_2d(camera.intrinsics.numpy())
    if len(intrinsics) not in (1, len(corners)):
        raise RenderingError(f"camera intrinsics are {intrinsics.shape}; allowed: (4,) or ({len(corners)}, 4)")
    depth = np.full((len(corners), camera.height, camera.width), np.inf, np.float32)
    arguments = (corners, triangles, intrinsics, float(near), depth)
    # Of small images one costs less than it takes to wake a thread.
    share(fill_depths, arguments, len(depth), available() if len(depth) >= _WORTH_THREADS else 1)
    return depth
