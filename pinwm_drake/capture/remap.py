# SPDX-License-Identifier: MIT
"""One remap that turns the images of any lens into those of a pinhole at the same place."""

import cv2
import numpy as np

from pinwm_drake.capture.lens import Lens
from pinwm_drake.rendering.camera import Camera

_HALF = 128  # of 255: share of a pixel from which on a mask has it
_COARSE, _MOST_OVERSAMPLING = 3.0, 4


class Remap:
    """Map from the pixels of a pinhole camera to those of a lens at the same place.

    Where the pinhole's pixels are coarser than the lens's by 3 or more, several samples are averaged in each.

    Args:
        lens: The lens.
        camera: The pinhole; intrinsics (4,).
        R_CV: (3, 3) rotation of the pinhole V in the lens's frame C, both with OpenCV's axes; None for the same axes.

    Attributes:
        camera: The pinhole.
        seen: (H, W) bool: pixels of the pinhole that the lens sees.
    """

    def __init__(self, lens: Lens, camera: Camera, R_CV: np.ndarray | None = None) -> None:
        self.camera = camera
        # A pinhole's step of one pixel, in pixels of the lens, on the optical axis.
        step = float(np.sqrt(np.prod(lens.intrinsics[:2] / camera.intrinsics[:2].numpy())))
        self._factor = int(np.clip(np.floor(step), 1, _MOST_OVERSAMPLING)) if step >= _COARSE else 1
        where = _places(lens, camera.scaled(self._factor), R_CV)
        # OpenCV's fixed-point maps take half the time; their steps are 1/32 px.
        self._maps = cv2.convertMaps((where - 0.5).astype(np.float32), None, cv2.CV_16SC2)  # type: ignore[call-overload]
        inside = (where >= 0.0).all(-1) & (where[..., 0] <= lens.width) & (where[..., 1] <= lens.height)
        shape = camera.height, self._factor, camera.width, self._factor
        self.seen = inside.reshape(shape).all((1, 3))

    def __call__(self, image: np.ndarray, outside: int = 255) -> np.ndarray:
        """Image of the pinhole: (H, W) or (H, W, channels), dtype as given.

        Args:
            image: Image of the lens: (height, width) or (height, width, channels) uint8 or float32.
            outside: Value of the pixels that the lens does not see.
        """
        colour = (outside,) * 4
        linear, fill = cv2.INTER_LINEAR, cv2.BORDER_CONSTANT
        found = cv2.remap(image, *self._maps, linear, borderMode=fill, borderValue=colour)  # type: ignore[call-overload]
        if self._factor == 1:
            return found
        return cv2.resize(found, (self.camera.width, self.camera.height), interpolation=cv2.INTER_AREA)

    def mask(self, mask: np.ndarray) -> np.ndarray:
        """Mask of the pinhole: (H, W) bool, true where half a pixel or more is in a mask (height, width) bool."""
        return self(255 * mask.astype(np.uint8), outside=0) >= _HALF


def _places(lens: Lens, camera: Camera, R_CV: np.ndarray | None) -> np.ndarray:
    """Places (H, W, 2) [px] in the lens's image of the pinhole's pixels; far outside where it looks elsewhere."""
    fx, fy, cx, cy = camera.intrinsics.tolist()
    x, y = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    rays = np.stack([(x - cx) / fx, (y - cy) / fy, np.ones_like(x)], -1).reshape(-1, 3)
    if R_CV is not None:
        rays = rays @ np.asarray(R_CV).T
    places = np.full((len(rays), 2), -1e4)
    ahead = rays[:, 2] > 1e-6
    pixels = lens.project(rays[ahead])
    # Beyond the place where a polynomial folds, its pixels are those of other rays.
    with np.errstate(invalid="ignore"):
        back = lens.rays(np.where(np.abs(pixels) < 1e5, pixels, np.nan))
        true = np.linalg.norm(back - rays[ahead, :2] / rays[ahead, 2:], axis=1) < 1e-4 * (
            1.0 + (rays[ahead, :2] ** 2).sum(1) / rays[ahead, 2] ** 2
        )
    places[ahead] = np.where(true[:, None], pixels, -1e4)
    return places.reshape(camera.height, camera.width, 2)


def whole_view(lens: Lens, mask: np.ndarray) -> Camera:
    """Pinhole with the lens's size, axes and principal point that shows all of a mask.

    Args:
        lens: The lens.
        mask: (height, width) bool, the pixels that are to be seen.

    Returns:
        The pinhole. Its focal lengths are those of the lens, or shorter where part of the mask would be cut off.
    """
    import torch

    rows, columns = np.nonzero(mask)
    focal, centre = lens.intrinsics[:2].copy(), lens.intrinsics[2:]
    if len(rows):
        edge = np.ones(len(rows), bool)
        inner = cv2.erode(mask.astype(np.uint8), np.ones((3, 3), np.uint8), borderValue=0).astype(bool)
        edge[inner[rows, columns]] = False
        rays = lens.rays(np.column_stack([columns, rows])[edge] + 0.5)
        rays = rays[np.isfinite(rays).all(1)]
        room = np.where(rays > 0.0, np.array([lens.width, lens.height]) - 0.5 - centre, centre - 0.5)
        with np.errstate(divide="ignore", invalid="ignore"):
            focal *= min(1.0, float(np.nanmin(room / (np.abs(rays) * focal), initial=1.0)))
    return Camera(lens.width, lens.height, torch.tensor([*focal, *centre], dtype=torch.float64))
