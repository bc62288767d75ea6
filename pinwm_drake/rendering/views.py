# SPDX-License-Identifier: MIT
"""Posed images of one object."""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from pinwm_drake.errors import RenderingError
from pinwm_drake.rendering.camera import Camera
from pinwm_drake.spatial.poses import Pose, transform

_NEAR = 1e-6  # m; nothing nearer to the camera can be projected


@dataclass(frozen=True, eq=False)
class View:
    """View of an object: an image, its camera, and the mask and pose of the object in it.

    Attributes:
        name: name of the view in messages, such as its file's name.
        camera: one camera.
        X_CO: pose of the object in the camera frame (OpenCV axes): q (4,), p (3,), m, float64.
        image: (H, W, 3) float32, colours from 0 to 1, white behind the object.
        mask: (H, W) bool, where the object is seen.

    Raises:
        RenderingError: sizes do not fit, or numbers are out of range; the message names the view.
    """

    name: str
    camera: Camera
    X_CO: Pose
    image: Tensor
    mask: Tensor

    def __post_init__(self) -> None:
        H, W = self.camera.height, self.camera.width
        given = {
            "image": (tuple(self.image.shape), (H, W, 3)),
            "mask": (tuple(self.mask.shape), (H, W)),
            "camera intrinsics": (tuple(self.camera.intrinsics.shape), (4,)),
            "q_CO": (tuple(self.X_CO.q.shape), (4,)),
            "p_CO": (tuple(self.X_CO.p.shape), (3,)),
        }
        for name, (found, wanted) in given.items():
            if found != wanted:
                raise RenderingError(f"view {self.name}: {name} is {found}; allowed: {wanted}")
        if self.image.dtype != torch.float32 or self.mask.dtype != torch.bool:
            raise RenderingError(
                f"view {self.name}: image and mask are {self.image.dtype} and {self.mask.dtype}; "
                "allowed: torch.float32 and torch.bool"
            )
        if not bool(((self.image >= 0.0) & (self.image <= 1.0)).all()):
            raise RenderingError(f"view {self.name}: the image has values outside 0 to 1; allowed: colours, 0 to 1")
        if not bool(torch.isfinite(torch.cat([self.X_CO.q, self.X_CO.p])).all()):
            raise RenderingError(f"view {self.name}: X_CO is not finite; allowed: a pose")

    def project(self, p_OQ: Tensor) -> tuple[Tensor, Tensor]:
        """Pixel positions and depths of points (n, 3), m, of the object; see the function `project`."""
        return project(self.camera, self.X_CO, p_OQ)

    def scaled(self, factor: float) -> "View":
        """Return the view with `factor` <= 1 times as many pixels a side, each the mean of those it covers."""
        camera = self.camera.scaled(factor)
        size = (camera.height, camera.width)
        pictures = torch.cat([self.image, self.mask[..., None].to(self.image.dtype)], -1).permute(2, 0, 1)[None]
        small = torch.nn.functional.interpolate(pictures, size, mode="area")[0].permute(1, 2, 0)
        image = small[..., :3].clamp(0.0, 1.0).contiguous()
        return View(self.name, camera, self.X_CO, image, small[..., 3] >= 0.5)

    def cropped(self, x: int, y: int, width: int, height: int) -> "View":
        """Return the box of the view whose first column and row are x and y."""
        rows, columns = slice(y, y + height), slice(x, x + width)
        camera = self.camera.cropped(x, y, width, height)
        image, mask = self.image[rows, columns].contiguous(), self.mask[rows, columns].contiguous()
        return View(self.name, camera, self.X_CO, image, mask)

    def object_box(self, p_OQ: Tensor, margin: int) -> tuple[int, int, int, int]:
        """Return the smallest box of pixels that holds the mask, the points of the object, and a margin around both.

        Args:
            p_OQ: (n, 3), m, in O, such as the corners of its mesh.
            margin: px.

        Returns:
            x, y, width, height in px, inside the image; the whole image where a point is behind the camera.
        """
        rows, columns = torch.nonzero(self.mask, as_tuple=True)
        seen = torch.stack([columns, rows], -1)
        return box_around(self.camera, self.X_CO, p_OQ, margin, torch.cat([seen, seen + 1]))

    def close_up(self, p_OQ: Tensor, margin: int, longest: float = math.inf) -> "View":
        """Return the box of `object_box` around points p_OQ (n, 3) m, smaller where it has more than so many px."""
        box = self.object_box(p_OQ, margin)
        return self.cropped(*box).scaled(min(longest / max(box[2:]), 1.0))


def project(camera: Camera, X_CO: Pose, p_OQ: Tensor) -> tuple[Tensor, Tensor]:
    """Pixel positions and depths of points of an object.

    Args:
        camera: camera of one view.
        X_CO: pose of the object in the camera frame: q (4,), p (3,), m.
        p_OQ: (n, 3), m, in O.

    Returns:
        (n, 2), x and y in px, not finite for points in the camera's plane; (n,), their z in C, m.
    """
    p_CQ = transform(X_CO, p_OQ.to(torch.float64))
    fx, fy, cx, cy = camera.intrinsics.unbind()
    z = p_CQ[:, 2]
    return torch.stack([fx * p_CQ[:, 0] / z + cx, fy * p_CQ[:, 1] / z + cy], -1), z


def box_around(
    camera: Camera, X_CO: Pose, p_OQ: Tensor, margin: int, pixels: Tensor | None = None
) -> tuple[int, int, int, int]:
    """Return the smallest box of pixels that holds points of an object and a margin around them.

    Args:
        camera: camera of one view.
        X_CO: pose of the object in the camera frame: q (4,), p (3,), m.
        p_OQ: (n, 3), m, in O, such as the corners of a mesh.
        margin: px.
        pixels: (k, 2), x and y in px that the box has to hold too.

    Returns:
        x, y, width, height in px, inside the image; the whole image where a point is behind the camera.
    """
    W, H = camera.width, camera.height
    at, z = project(camera, X_CO, p_OQ)
    if bool((z <= _NEAR).any()):
        return 0, 0, W, H
    ends = at if pixels is None else torch.cat([at, pixels.to(at)])
    low, high = (ends.amin(0).floor() - margin).tolist(), (ends.amax(0).ceil() + margin).tolist()
    left, top = min(max(int(low[0]), 0), W - 1), min(max(int(low[1]), 0), H - 1)
    right, bottom = min(max(int(high[0]), left + 1), W), min(max(int(high[1]), top + 1), H)
    return left, top, right - left, bottom - top
