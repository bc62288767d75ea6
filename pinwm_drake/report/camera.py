# SPDX-License-Identifier: MIT
"""Pinhole camera of the report's small renderer."""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:  # which load torch
    from pinwm_drake.rendering.camera import Camera
    from pinwm_drake.spatial.poses import Pose


@dataclass(frozen=True)
class ViewCamera:
    """Pinhole camera whose frame C has x to the right, y down and z forward."""

    R_WC: np.ndarray  # (3, 3)
    p_WC: np.ndarray  # (3,) [m]
    focal: float | np.ndarray  # px; one, or (2,) along x and y
    width: int  # px
    height: int  # px
    centre: np.ndarray | None = None  # (2,) px, where its axis meets the image; None for the middle

    @classmethod
    def look_at(
        cls, eye: np.ndarray, target: np.ndarray, *, width: int, height: int, field_of_view: float
    ) -> "ViewCamera":
        """Return a camera at one point that looks at another, with its x axis horizontal.

        Args:
            eye: p_WC (3,) [m].
            target: (3,) [m], world; not straight above or below the eye.
            width: Image width [px].
            height: Image height [px].
            field_of_view: Vertical angle of view [rad].
        """
        z = np.asarray(target, float) - eye
        z /= np.linalg.norm(z)
        x = np.cross(z, [0.0, 0.0, 1.0])
        x /= np.linalg.norm(x)
        R_WC = np.column_stack((x, np.cross(z, x), z))
        focal = 0.5 * height / math.tan(0.5 * field_of_view)
        return cls(R_WC, np.asarray(eye, float), focal, width, height)

    @classmethod
    def of(cls, camera: "Camera", X_WC: "Pose") -> "ViewCamera":
        """Camera of a capture or a scene, at a pose q (4,), p (3,) [m] in the world."""
        from pinwm_drake.spatial.rotations import quaternion_to_matrix

        numbers = camera.intrinsics.numpy().astype(float)
        R_WC = quaternion_to_matrix(X_WC.q).numpy()
        return cls(R_WC, X_WC.p.numpy(), numbers[:2], camera.width, camera.height, numbers[2:])

    def scaled(self, factor: int) -> "ViewCamera":
        """Camera of the same view with `factor` times the pixels along each side."""
        width, height = self.width * factor, self.height * factor
        return ViewCamera(self.R_WC, self.p_WC, self.focal * factor, width, height, self._middle * factor)

    @property
    def _middle(self) -> np.ndarray:
        """Where its axis meets the image (2,) [px]."""
        return 0.5 * np.array([self.width, self.height]) if self.centre is None else self.centre

    def project(self, p_W: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Pixels (n, 2) and depths (n,) [m] of points p_W (n, 3) [m] in front of the camera.

        Pixels count to the right and down from the top left corner.
        """
        p_C = (p_W - self.p_WC) @ self.R_WC
        return self.focal * p_C[:, :2] / p_C[:, 2:] + self._middle, p_C[:, 2]

    def rays(self) -> np.ndarray:
        """Return the direction through the centre of every pixel: (height, width, 3), unit, world."""
        d_W = self._rays()
        return d_W / np.linalg.norm(d_W, axis=-1, keepdims=True)

    def points(self, depth: np.ndarray, shown: np.ndarray) -> np.ndarray:
        """Points p_W (n, 3) [m] that are seen at the pixels of a mask (height, width), at depths (n,) [m]."""
        return self.p_WC + depth[:, None] * self._rays()[shown]

    def _rays(self) -> np.ndarray:
        """Return the direction through the centre of every pixel, of depth 1: (height, width, 3), world."""
        x, y = np.meshgrid(np.arange(self.width) + 0.5, np.arange(self.height) + 0.5)
        away = (np.stack((x, y), axis=-1) - self._middle) / self.focal
        return np.concatenate((away, np.ones((*x.shape, 1))), axis=-1) @ self.R_WC.T
