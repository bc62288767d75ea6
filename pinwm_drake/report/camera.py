# SPDX-License-Identifier: MIT
"""Pinhole camera of the report's small renderer."""

import math
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class ViewCamera:
    """Pinhole camera whose frame C has x to the right, y down and z forward."""

    R_WC: np.ndarray  # (3, 3)
    p_WC: np.ndarray  # (3,) [m]
    focal: float  # px
    width: int  # px
    height: int  # px

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

    def scaled(self, factor: int) -> "ViewCamera":
        """Camera of the same view with `factor` times the pixels along each side."""
        return ViewCamera(self.R_WC, self.p_WC, self.focal * factor, self.width * factor, self.height * factor)

    def project(self, p_W: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Pixels (n, 2) and depths (n,) [m] of points p_W (n, 3) [m] in front of the camera.

        Pixels count to the right and down from the top left corner.
        """
        p_C = (p_W - self.p_WC) @ self.R_WC
        centre = 0.5 * np.array([self.width, self.height])
        return self.focal * p_C[:, :2] / p_C[:, 2:] + centre, p_C[:, 2]

    def rays(self) -> np.ndarray:
        """Return the direction through the centre of every pixel: (height, width, 3), unit, world."""
        x, y = np.meshgrid(np.arange(self.width) + 0.5, np.arange(self.height) + 0.5)
        d_C = np.stack((x - 0.5 * self.width, y - 0.5 * self.height, np.full_like(x, self.focal)), axis=-1)
        d_W = d_C @ self.R_WC.T
        return d_W / np.linalg.norm(d_W, axis=-1, keepdims=True)
