# SPDX-License-Identifier: MIT
"""Pictures of an environment for people: the camera's image, with goal and pusher drawn into it."""

from collections.abc import Sequence

import cv2
import numpy as np
import torch

from pinwm_drake.capture.pusher import pusher_surface
from pinwm_drake.geometry.meshes import load_mesh
from pinwm_drake.rendering.camera import Camera
from pinwm_drake.rendering.occluder import mesh_depth
from pinwm_drake.spatial.poses import transform
from pinwm_drake.systems.scenario.setup import Setup
from pinwm_drake.systems.scenario.start import StartDistribution

_LEAST = 256  # px, of the shorter side
_GOAL, _PUSHER = (40, 160, 70), (70, 70, 80)  # RGB
_NEAR = 1e-3  # m


class TaskPicture:
    """Painter of pictures of one world."""

    def __init__(self, setup: Setup) -> None:
        width, height = setup.camera.width, setup.camera.height
        self._factor = f = -(-_LEAST // min(height, width))
        self._camera = Camera.from_field_of_view(f * width, f * height, setup.scenario.camera.fov_y)
        self._X_CW = setup.X_WC.inverse()
        mesh = load_mesh(setup.twin.mesh_path)
        X_WG = setup.task.goal_pose(StartDistribution(setup).middle().X_WO.translation()[2])
        self._outline: Sequence[np.ndarray] = ()
        if X_WG is not None:
            vertices_W = transform(X_WG, torch.as_tensor(np.asarray(mesh.vertices))).numpy()
            goal = self._silhouette(vertices_W, np.asarray(mesh.faces))
            self._outline = cv2.findContours(goal.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[0]
        pusher = pusher_surface(setup.twin.pusher, sections=24)
        self._pusher = np.asarray(pusher.vertices), np.asarray(pusher.faces)

    def draw(self, image: np.ndarray, p_WP: np.ndarray) -> np.ndarray:
        """Draws goal and pusher into an enlarged image.

        Args:
            image: (height, width, 3 or 4) uint8, RGB or RGBA: the object on white.
            p_WP: (3,) m, world: position of the pusher.

        Returns:
            (f height, f width, 3) uint8, RGB, with a whole factor f that makes it 256 px or larger.
        """
        f = self._factor
        vertices, faces = self._pusher
        picture = np.ascontiguousarray(np.repeat(np.repeat(image[..., :3], f, axis=0), f, axis=1))
        shown = self._silhouette(vertices + p_WP, faces)
        # The object hides the pusher where it stands before it; a policy's own image says so only by being whole.
        picture[shown & (picture.min(axis=2) == 255)] = _PUSHER
        cv2.drawContours(picture, self._outline, -1, _GOAL, 2)
        return picture

    def _silhouette(self, vertices_W: np.ndarray, faces: np.ndarray) -> np.ndarray:
        """Mask (f height, f width) bool of the pixels in which a mesh is seen.

        Args:
            vertices_W: (n, 3) m, world: corners of the mesh.
            faces: (m, 3) indices of the corners of its triangles.
        """
        vertices_C = self._X_CW.multiply(vertices_W.T).T
        return np.asarray(np.isfinite(mesh_depth(vertices_C[None], faces, self._camera, _NEAR)[0]))
