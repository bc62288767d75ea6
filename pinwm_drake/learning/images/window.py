# SPDX-License-Identifier: MIT
"""The window of an image that a policy looks at: as large as its object needs, around what is not background."""

import math

import numpy as np
import torch
from scipy.spatial.transform import Rotation
from torch import Tensor, nn

from pinwm_drake.errors import ParameterError
from pinwm_drake.learning.spec import PolicySpec

_MARGIN = 1.7  # side of the window by the diagonal of the object: it moves between the images, and so does the pusher
_ALONE = 1.4  # the same, where each image has a window of its own
_BORDER = 4  # px on each side that a part has beside its window, so that it can still move
_SHOWN = 24.0  # sum of the darkness of three channels from which on a pixel counts as shown
_MULTIPLE = 4  # px, so that strides leave no remainder
_STEEP = -0.05  # z of a line of sight from which on it counts as meeting the floor


def window_size(spec: PolicySpec) -> int | None:
    """Side [px] of a window around a policy's object; None where its scene is not known, or the image has no more."""
    if spec.scene is None:
        return None
    camera = spec.camera
    away = Rotation.from_quat(np.roll(camera.q_WC, -1)).as_matrix()[2, 2]
    far = (spec.scene.floor_height - camera.p_WC[2]) / min(away, _STEEP)  # m, to the floor in the middle of the image
    diagonal = max(camera.fx, camera.fy) * math.hypot(*spec.scene.object.size) / far
    side = _MULTIPLE * math.ceil((_ALONE if spec.history else _MARGIN) * diagonal / _MULTIPLE)
    return side if side < min(camera.width, camera.height) else None


def part_size(spec: PolicySpec) -> tuple[int, int]:
    """Height and width [px] of what a student keeps of an image: a part where it sees them one by one; see `Window`."""
    if not spec.history or spec.window is None:
        return spec.camera.height, spec.camera.width
    return spec.window + 2 * _BORDER, spec.window + 2 * _BORDER


class Window(nn.Module):
    """Module from images (B, 3 k, height, width) to a window of them around the object, and to its place on the floor.

    The window is around the middle of what is not white in the newest image: the object, and where it is seen the
    pusher. All images of a stack are cut at the same place, so that they show how it moves.
    """

    _R_CW: Tensor
    _p_WC: Tensor
    _columns: Tensor
    _rows: Tensor
    _steps: Tensor

    def __init__(self, spec: PolicySpec) -> None:
        """Take camera, floor and object of a policy whose specification has a window.

        Raises:
            ParameterError: It has no scene.
        """
        super().__init__()
        assert spec.window is not None
        if spec.scene is None:
            raise ParameterError(f"scene: got none beside a window of {spec.window} px; allowed: object and floor")
        self._side, self._spec = spec.window, spec.camera
        level = spec.scene.floor_height + 0.5 * min(spec.scene.object.size)
        R_WC = Rotation.from_quat(np.roll(spec.camera.q_WC, -1)).as_matrix()
        # Of an image by itself what is shown counts, and not how dark it is: light differs from place to place.
        self._most = _SHOWN if spec.history else 255.0
        self._above = float(spec.camera.p_WC[2]) - level
        self.register_buffer("_R_CW", torch.tensor(R_WC.T).float(), persistent=False)
        self.register_buffer("_p_WC", torch.tensor(spec.camera.p_WC[:2]).float(), persistent=False)
        self.register_buffer("_columns", torch.arange(spec.camera.width).float(), persistent=False)
        self.register_buffer("_rows", torch.arange(spec.camera.height).float(), persistent=False)
        self.register_buffer("_steps", torch.arange(spec.window).float(), persistent=False)

    def forward(self, image: Tensor, corner: Tensor | None = None, tint: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """Window (B, 3 k, side, side) of images, and the place (B, 2) m, world, that its middle shows.

        The window is float32, 0 for white and 1 for black.

        Args:
            image: (B, height, width, 3 k) RGB, uint8 or floats from 0 to 255; the background is white. What is not in
                the window stays as it comes: numbers as floats are four times as long.
            corner: (B, 2) px, x and y of the first pixel, where images are parts, as `part` gives them; None where they
                are whole.
            tint: (B, 3 k) factors of the darkness of images that are parts as `part` gave them, so that their windows
                are known; None for other images.
        """
        if tint is not None:
            assert corner is not None, "a tint is of parts"
            part = image[:, _BORDER:-_BORDER, _BORDER:-_BORDER]
            window = part.float().sub_(255.0).mul_((tint / -255.0)[:, None, None]).clamp_(max=1.0).permute(0, 3, 1, 2)
            x, y = (corner[:, axis] + (_BORDER + self._side // 2) for axis in (0, 1))
            return window, self._place(x.float(), y.float())
        x, y = self._middle(image, whole=corner is None)
        found, inside = self._cut(image, x, y, self._steps)
        window = found.float().sub_(255.0).mul_((inside / -255.0)[:, :, :, None]).permute(0, 3, 1, 2)
        if corner is not None:
            x, y = x + corner[:, 0], y + corner[:, 1]
        return window, self._place(x, y)

    def part(self, image: Tensor) -> tuple[Tensor, Tensor]:
        """Part (B, side + 8, side + 8, 3 k) of whole images around the window, and its corner (B, 2) px, int64.

        It is white beyond the image. The window of a part is that of the image, as long as the part has all of the
        object.
        """
        x, y = self._middle(image)
        steps = torch.arange(-_BORDER, self._side + _BORDER, device=image.device).float()
        found, inside = self._cut(image, x, y, steps)
        corner = torch.stack([x, y], 1).long() - _BORDER - self._side // 2
        return torch.where(inside[:, :, :, None], found, 255), corner

    def _middle(self, image: Tensor, *, whole: bool = True) -> tuple[Tensor, Tensor]:
        """Pixels x and y (B,) float32 of the middle of what is dark in the newest of images, or that of the camera."""
        # One after another: sums over three numbers take twice as long.
        there = (image[..., -3].float() + image[..., -2] + image[..., -1] - 3.0 * 255.0).neg().clamp(0.0, self._most)
        total = there.sum((1, 2))
        some, total = total > 0.0, total.clamp(min=1.0)
        columns, rows, middle = self._columns, self._rows, (self._spec.cx, self._spec.cy)
        if not whole:
            columns = rows = torch.arange(image.shape[1], device=image.device).float()
            middle = (0.5 * image.shape[1], 0.5 * image.shape[1])
        x = torch.where(some, (there.sum(1) * columns).sum(1) / total, middle[0]).round()
        y = torch.where(some, (there.sum(2) * rows).sum(1) / total, middle[1]).round()
        return x, y

    def _cut(self, image: Tensor, x: Tensor, y: Tensor, steps: Tensor) -> tuple[Tensor, Tensor]:
        """Pixels (B, s, s, 3 k) of images at steps (s,) from half a window before pixels (B,).

        The second is false, (B, s, s), beyond the image.
        """
        height, width = image.shape[1:3]
        # Whole numbers of one axis are sizes to ONNX, which refuses to add as many as images and as steps.
        rows = (y[:, None] + steps - self._side // 2).long()
        columns = (x[:, None] + steps - self._side // 2).long()
        inside = ((rows >= 0) & (rows < height))[:, :, None] & ((columns >= 0) & (columns < width))[:, None, :]
        # Pixels, whose channels lie side by side, are copied whole: a quarter of the time that single numbers take.
        pixels = image.flatten(0, 2)
        first = height * width * torch.arange(len(image), device=image.device)
        row = first[:, None] + width * rows.clamp(0, height - 1)
        at = (row[:, :, None] + columns.clamp(0, width - 1)[:, None, :]).flatten()
        return pixels.index_select(0, at).unflatten(0, (len(image), len(steps), len(steps))), inside

    def _place(self, x: Tensor, y: Tensor) -> Tensor:
        """Places (B, 2) m, world, where the lines of sight of pixels (B,) meet the level of the object's middle."""
        camera = self._spec
        across, down = (x + 0.5 - camera.cx) / camera.fx, (y + 0.5 - camera.cy) / camera.fy
        ray_W = torch.stack([across, down, torch.ones_like(x)], 1) @ self._R_CW
        return self._p_WC - self._above / ray_W[:, 2:].clamp(max=_STEEP) * ray_W[:, :2]
