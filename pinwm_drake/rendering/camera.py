# SPDX-License-Identifier: MIT
"""Pinhole cameras and their intrinsics.

The camera frame C has OpenCV's axes: x right, y down, z forward. Pixel (row i, column j) covers the square from
(j, i) to (j + 1, i + 1) of the image plane; its centre is (j + 0.5, i + 0.5).
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from pinwm_drake.errors import RenderingError

_MAX_SIZE = 16384


@dataclass(frozen=True, eq=False)
class Camera:
    """One pinhole camera, or V of them with images of one size.

    Attributes:
        width: columns, px.
        height: rows, px.
        intrinsics: (4,) or (V, 4) float64: fx, fy, cx, cy, px. A point p_C is seen at x = fx X / Z + cx,
            y = fy Y / Z + cy.

    Raises:
        RenderingError: a size or an intrinsic is out of range; the message names it.
    """

    width: int
    height: int
    intrinsics: Tensor

    def __post_init__(self) -> None:
        for name in ("width", "height"):
            if not 1 <= getattr(self, name) <= _MAX_SIZE:
                raise RenderingError(f"camera {name} is {getattr(self, name)}; allowed: 1 to {_MAX_SIZE} px")
        values = torch.as_tensor(self.intrinsics, dtype=torch.float64)
        object.__setattr__(self, "intrinsics", values)
        if values.ndim not in (1, 2) or values.shape[-1] != 4:
            raise RenderingError(f"camera intrinsics are {tuple(values.shape)}; allowed: (4,) or (V, 4)")
        if not bool(torch.isfinite(values).all()) or not bool((values[..., :2] > 0.0).all()):
            raise RenderingError(
                f"camera intrinsics are {values.tolist()}; allowed: finite fx, fy, cx, cy with fx, fy positive, px"
            )

    @staticmethod
    def from_field_of_view(width: int, height: int, fov_y: float) -> "Camera":
        """Return a camera with square pixels that looks through the middle of its image; fov_y in rad."""
        focal = 0.5 * height / torch.tan(torch.tensor(0.5 * fov_y, dtype=torch.float64))
        return Camera(width, height, torch.tensor([focal, focal, 0.5 * width, 0.5 * height], dtype=torch.float64))

    def scaled(self, factor: float) -> "Camera":
        """Return the camera of the same view with `factor` times as many pixels a side, rounded."""
        width, height = max(round(self.width * factor), 1), max(round(self.height * factor), 1)
        x, y = width / self.width, height / self.height
        return Camera(width, height, self.intrinsics * self.intrinsics.new_tensor([x, y, x, y]))

    def cropped(self, x: int, y: int, width: int, height: int) -> "Camera":
        """Return the camera of a box of the image whose first column and row are x and y."""
        return Camera(width, height, self.intrinsics - self.intrinsics.new_tensor([0.0, 0.0, x, y]))

    def shifted(self, offset: tuple[float, float]) -> "Camera":
        """Return the camera with `offset` [px] added to cx and cy."""
        return Camera(self.width, self.height, self.intrinsics + self.intrinsics.new_tensor([0.0, 0.0, *offset]))


def zoomed(intrinsics: Tensor, scale: Tensor, about: Tensor) -> Tensor:
    """Intrinsics with which everything appears larger about a point of the image, which stays where it is.

    Args:
        intrinsics: (..., 4), as those of `Camera`.
        scale: (...), by which.
        about: (..., 2), the point, px.

    Returns:
        (..., 4), leading axes broadcast.
    """
    focal, centre = intrinsics[..., :2], intrinsics[..., 2:]
    scale = scale[..., None]
    return torch.cat([focal * scale, about + (centre - about) * scale], -1)
