# SPDX-License-Identifier: MIT
"""Orbit of a camera around an object, for turntables and for the viewers' first look."""

import math
from dataclasses import dataclass

import numpy as np
import torch

from pinwm_drake.errors import RenderingError
from pinwm_drake.rendering.camera import Camera
from pinwm_drake.rendering.surfels import Surfels
from pinwm_drake.spatial.poses import Pose
from pinwm_drake.spatial.rotations import matrix_to_quaternion

FIELD_OF_VIEW = math.radians(30.0)  # of the image's height
AZIMUTH, ELEVATION = math.radians(40.0), math.radians(35.0)  # of the first look
Z_AXIS = (0.0, 0.0, 1.0)

_FAINT = 0.1  # surfels of less opacity do not count for where the object is
_STRAY = 0.5  # % of the surfels, at either end of an axis, that do not either
_MARGIN = 1.15  # of the picture, around a ball that holds the object


@dataclass(frozen=True, eq=False)
class Orbit:
    """Orbit of cameras at one distance from a point, looking at it."""

    target: np.ndarray  # (3,) [m], object frame O
    distance: float  # m
    up: np.ndarray  # (3,), unit, O: shows upwards in the pictures

    @classmethod
    def around(cls, surfels: Surfels, up: np.ndarray | None = None) -> "Orbit":
        """Orbit from which a camera of `FIELD_OF_VIEW` sees all of an object; `up` (3,) in O is not zero, None for z.

        Raises:
            RenderingError: There are no surfels.
        """
        if surfels.num_surfels == 0:
            raise RenderingError("there are 0 surfels; allowed: 1 or more to look at")
        opacity = surfels.logit_opacity.detach().sigmoid().numpy()
        points = surfels.p_OS.detach().numpy()[opacity >= min(_FAINT, opacity.max())].astype(float)
        low, high = np.percentile(points, [_STRAY, 100 - _STRAY], axis=0)
        radius = max(0.5 * float(np.linalg.norm(high - low)), 1e-3)
        upward = np.array(Z_AXIS if up is None else up, float)
        distance = _MARGIN * radius / math.sin(0.5 * FIELD_OF_VIEW)
        return cls(0.5 * (low + high), distance, upward / np.linalg.norm(upward))

    def axes(self) -> np.ndarray:
        """Axes (3, 3): the directions of azimuth 0, of azimuth 90 degrees and up, as rows, unit, O."""
        helper = np.eye(3)[0] if abs(self.up[0]) < 0.9 else np.eye(3)[1]
        first = helper - (helper @ self.up) * self.up
        first /= np.linalg.norm(first)
        return np.stack((first, np.cross(self.up, first), self.up))

    def pose(self, azimuth: float, elevation: float) -> Pose:
        """Pose X_CO of the object in a camera with OpenCV's axes, q (4,), p (3,) [m], at two angles [rad].

        The elevation is more than -pi/2 and less than pi/2.
        """
        first, second, up = self.axes()
        level = math.cos(azimuth) * first + math.sin(azimuth) * second
        outward = math.cos(elevation) * level + math.sin(elevation) * up
        right = math.cos(azimuth) * second - math.sin(azimuth) * first
        R_CO = np.stack((right, np.cross(right, outward), -outward))
        p_CO = -R_CO @ (self.target + self.distance * outward)
        return Pose(matrix_to_quaternion(torch.from_numpy(R_CO)), torch.from_numpy(p_CO))


def square_camera(size: int) -> Camera:
    """Camera of a square picture, `size` px wide."""
    return Camera.from_field_of_view(size, size, FIELD_OF_VIEW)
