"""Triangle rasteriser with a depth buffer in numpy, enough for a few hundred triangles a frame."""

from dataclasses import dataclass

import numpy as np

from pinwm_drake.report.camera import ViewCamera


@dataclass
class Surface:
    """Buffers of the surface that each pixel shows: the nearest one so far.

    Attributes:
        inverse_depth: (height, width) [1/m], 0 where there is nothing.
        normal: (height, width, 3), outward, world, not quite of unit length where it is interpolated.
        colour: (height, width, 3), linear RGB in [0, 1].
    """

    inverse_depth: np.ndarray
    normal: np.ndarray
    colour: np.ndarray

    @classmethod
    def empty(cls, camera: ViewCamera) -> "Surface":
        """Buffers in which nothing has been drawn."""
        shape = (camera.height, camera.width)
        return cls(np.zeros(shape, np.float32), np.zeros((*shape, 3), np.float32), np.zeros((*shape, 3), np.float32))


def draw_triangles(
    surface: Surface, camera: ViewCamera, corners_W: np.ndarray, normals_W: np.ndarray, colour: np.ndarray
) -> None:
    """Draws triangles where they are nearer than the surface in the buffers.

    Args:
        surface: The buffer, changed in place; of the camera's size.
        camera: The view. All triangles lie in front of it.
        corners_W: (n, 3, 3) [m], corners of each triangle, counter-clockwise seen from outside, world.
        normals_W: (n, 3, 3), outward normal at each corner, world.
        colour: (3,), linear RGB in [0, 1].
    """
    pixels, depths = camera.project(corners_W.reshape(-1, 3))
    pixels, inverse = pixels.reshape(-1, 3, 2), (1 / depths).reshape(-1, 3)
    a, b, c = pixels[:, 0], pixels[:, 1], pixels[:, 2]
    # With y down a triangle that faces the camera runs clockwise: its doubled area is negative.
    areas = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
    size = np.array([camera.width, camera.height])
    lows = np.clip(np.floor(pixels.min(axis=1)).astype(int), 0, size)
    highs = np.clip(np.ceil(pixels.max(axis=1)).astype(int), 0, size)
    for k in np.flatnonzero((areas < 0) & (lows < highs).all(axis=1)):
        (x0, y0), (x1, y1) = lows[k], highs[k]
        x, y = np.arange(x0, x1) + 0.5, (np.arange(y0, y1) + 0.5)[:, None]
        weights = []
        for i, j in ((1, 2), (2, 0)):
            (px, py), (qx, qy) = pixels[k, i], pixels[k, j]
            weights.append((((qx - px) * (y - py) - (qy - py) * (x - px)) / areas[k]).astype(np.float32))
        weights.append(1 - weights[0] - weights[1])
        depth = sum(weight * value for weight, value in zip(weights, inverse[k], strict=True))
        window = np.s_[y0:y1, x0:x1]
        shown = (weights[0] >= 0) & (weights[1] >= 0) & (weights[2] >= 0)
        shown &= depth > surface.inverse_depth[window]
        surface.inverse_depth[window][shown] = depth[shown]
        mix = np.stack([weight[shown] for weight in weights], axis=-1)
        surface.normal[window][shown] = mix @ normals_W[k].astype(np.float32)
        surface.colour[window][shown] = colour
