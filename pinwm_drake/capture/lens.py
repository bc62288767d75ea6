# SPDX-License-Identifier: MIT
"""Lenses with distortion: OpenCV's polynomial model and its fisheye model.

Pixels are those of `Camera`: the centre of the first one is at (0.5, 0.5). OpenCV has it at (0, 0), so that its
principal point is half a pixel less.
"""

from dataclasses import dataclass, replace
from typing import Literal, get_args

import cv2
import numpy as np

from pinwm_drake.errors import RenderingError

LensModel = Literal["opencv", "fisheye"]
LENS_MODELS: tuple[LensModel, ...] = get_args(LensModel)
# Numbers of distortion: k1, k2, p1, p2, k3 (then k4, k5, k6 of the rational model); or k1 to k4 of the fisheye.
DISTORTIONS = {"opencv": (5, 8), "fisheye": (4,)}
_HALF = np.array([0.0, 0.0, 0.5, 0.5])
_STEPS, _EXACT = 100, 1e-12  # of OpenCV's iteration from pixels to rays: most of them, and change at the end
_ROUND_TRIP = 1e-3  # px, by which a ray's pixel may be off before the ray counts as none
_WIDEST = np.radians(89.0)  # from the optical axis: rays farther out have no place in a pinhole


@dataclass(frozen=True, eq=False)
class Lens:
    """Camera with distortion.

    Attributes:
        width, height: Size of its images, px.
        model: "opencv" or "fisheye".
        intrinsics: (4,) fx, fy, cx, cy, px.
        distortion: (5,) or (8,) k1, k2, p1, p2, k3 (k4, k5, k6) of "opencv", (4,) k1 to k4 of "fisheye".

    Raises:
        RenderingError: The model is unknown, or a number is not finite; the message names it.
    """

    width: int
    height: int
    model: LensModel
    intrinsics: np.ndarray
    distortion: np.ndarray

    def __post_init__(self) -> None:
        if self.model not in LENS_MODELS:
            raise RenderingError(f"lens model is {self.model}; allowed: {', '.join(LENS_MODELS)}")
        for name, sizes in (("intrinsics", (4,)), ("distortion", DISTORTIONS[self.model])):
            values = np.array(getattr(self, name), float)
            if values.shape not in [(size,) for size in sizes] or not np.isfinite(values).all():
                allowed = " or ".join(map(str, sizes))
                raise RenderingError(f"lens {name} is {values.tolist()}; allowed: {allowed} finite numbers")
            object.__setattr__(self, name, values)
        if not (self.intrinsics[:2] > 0.0).all():
            raise RenderingError(f"lens intrinsics are {self.intrinsics.tolist()}; allowed: fx, fy above 0 px")

    @property
    def parameters(self) -> np.ndarray:
        """Intrinsics and distortion one after the other: (9,), (12,) or (8,)."""
        return np.concatenate([self.intrinsics, self.distortion])

    def with_parameters(self, parameters: np.ndarray) -> "Lens":
        """Return the lens with other intrinsics and distortion (4 + d,), in the order of `parameters`."""
        return replace(self, intrinsics=parameters[:4], distortion=parameters[4:])

    @property
    def opencv_matrix(self) -> np.ndarray:
        """Camera matrix (3, 3) in OpenCV's pixels, whose first centre is at (0, 0)."""
        fx, fy, cx, cy = self.intrinsics - _HALF
        return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])

    def project(self, p_C: np.ndarray) -> np.ndarray:
        """Pixels (N, 2) of points p_C (N, 3) [m] in front of the camera, OpenCV axes."""
        return self.project_with_jacobian(p_C)[0]

    def project_with_jacobian(self, p_C: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Pixels (N, 2) of points p_C (N, 3) [m], their derivatives by p_C (N, 2, 3) [px/m] and by `parameters`."""
        points, zero = np.ascontiguousarray(p_C, float).reshape(-1, 1, 3), np.zeros(3)
        if not len(points):  # OpenCV has no empty arrays
            return np.zeros((0, 2)), np.zeros((0, 2, 3)), np.zeros((0, 2, len(self.parameters)))
        project = cv2.projectPoints if self.model == "opencv" else cv2.fisheye.projectPoints
        pixels, found = project(points, zero, zero, self.opencv_matrix, self.distortion)
        jacobian = np.asarray(found).reshape(len(points), 2, -1)
        # Columns: rotation, translation, f, c, distortion; or, of the fisheye, f, c, distortion, rotation, translation.
        if self.model == "opencv":
            by_point, by_lens = jacobian[..., 3:6], jacobian[..., 6:]
        else:
            by_point, by_lens = jacobian[..., 11:14], jacobian[..., :8]
        return pixels.reshape(-1, 2) + 0.5, by_point, by_lens

    def rays(self, pixels: np.ndarray) -> np.ndarray:
        """Rays (N, 2) = (x / z, y / z) of pixels (N, 2); NaN where the model has none, or none in front."""
        points = np.ascontiguousarray(pixels, float).reshape(-1, 1, 2) - 0.5
        if not len(points):
            return np.zeros((0, 2))
        end = cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, _STEPS, _EXACT
        if self.model == "opencv":
            found = cv2.undistortPointsIter(points, self.opencv_matrix, self.distortion, None, None, end)  # type: ignore[call-overload]
        else:
            found = cv2.fisheye.undistortPoints(points, self.opencv_matrix, self.distortion, criteria=end)
        rays = np.asarray(found).reshape(-1, 2)
        with np.errstate(invalid="ignore"):
            wrong = ~(np.linalg.norm(rays, axis=1) < np.tan(_WIDEST))  # NaN too
        rays[wrong] = 0.0
        again = self.project(np.column_stack([rays, np.ones(len(rays))]))
        rays[wrong | ~(np.linalg.norm(again - pixels.reshape(-1, 2), axis=1) < _ROUND_TRIP)] = np.nan
        return rays
