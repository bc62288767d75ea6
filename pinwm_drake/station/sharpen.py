# SPDX-License-Identifier: MIT
"""Corners of a board to a few hundredths of a pixel, by drawing the board as the lens should see it.

Around each corner the photo is compared with the drawing, and the shift between them is found by least squares, with a
gain and an offset of brightness. Markers beside a corner, which pull at a search for its two edges, are in the drawing.
"""

import cv2
import numpy as np

from pinwm_drake.capture.lens import Lens
from pinwm_drake.spatial.rigid import apply
from pinwm_drake.station.board import FEWEST_CORNERS, Board, Seen

_STEP = 8  # px between the pixels whose rays are found; those between are interpolated
_TEXELS = 96  # of a square's side in the drawing
_OVER = 2  # samples along each side of a pixel
_BLUR = 0.7  # px, of a usual lens in focus
_REACH, _LEAST, _MOST = 0.6, 4, 16  # half a window, as a share of a square's side, and its limits, px
_FARTHEST = 2.0  # px, that a corner may be from where the lens has it
_ALIKE = 0.9  # least correlation of photo and drawing: a hand or a glare is before the board otherwise
_ROUNDS = 3


class Sharpener:
    """Finder of corners near the places where a lens should see them."""

    def __init__(self, board: Board, lens: Lens) -> None:
        self._board, self._lens = board, lens
        x = np.arange(0.0, lens.width + _STEP, _STEP)
        y = np.arange(0.0, lens.height + _STEP, _STEP)
        grid = np.stack(np.meshgrid(x, y), -1)
        self._rays = lens.rays(grid.reshape(-1, 2)).reshape(grid.shape).astype(np.float32)
        nx, ny = board.squares
        drawn = np.full((_TEXELS * ny, _TEXELS * nx), 255, np.uint8)
        scale = _TEXELS / board.square
        for left, top, width, height in board.cells():
            (x0, y0), (x1, y1) = (
                np.round(scale * np.array(corner)).astype(int) for corner in ((left, top), (left + width, top + height))
            )
            drawn[y0:y1, x0:x1] = 0
        self._drawn, self._scale = drawn, scale

    def find(self, grey: np.ndarray, X_CM: np.ndarray) -> Seen | None:
        """Corners in a photo (height, width) uint8 of a board at about X_CM (4, 4); None where there are too few."""
        p_C = apply(X_CM, self._board.corners_M)
        if (p_C[:, 2] < 1e-3).any():
            return None
        pixels = self._lens.project(p_C)
        inside = (pixels > 2.0).all(1) & (pixels < [grey.shape[1] - 2.0, grey.shape[0] - 2.0]).all(1)
        if inside.sum() < FEWEST_CORNERS:
            return None
        numbers, found = list[int](), list[np.ndarray]()
        left, top = np.maximum(np.floor(pixels[inside].min(0)).astype(int) - 2 * _MOST, 0)
        right, bottom = np.ceil(pixels[inside].max(0)).astype(int) + 2 * _MOST
        box = grey[top:bottom, left:right].astype(np.float32)
        drawing = self._draw(X_CM, left, top, box.shape[1], box.shape[0])
        half = self._window(pixels)
        for number in np.flatnonzero(inside):
            place = pixels[number] - [left, top]
            shift = _shift(box, drawing, place - 0.5, half)
            if shift is not None:
                numbers.append(int(number))
                found.append(pixels[number] + shift)
        return Seen(np.array(numbers), np.array(found)) if len(found) >= FEWEST_CORNERS else None

    def _window(self, pixels: np.ndarray) -> int:
        """Half of a window, px, by the sides of the squares in the photo."""
        nx, ny = self._board.squares
        grid = pixels.reshape(ny - 1, nx - 1, 2)
        sides = np.concatenate([np.linalg.norm(np.diff(grid, axis=axis), axis=-1).ravel() for axis in (0, 1)])
        return int(np.clip(_REACH * np.median(sides), _LEAST, _MOST))

    def _draw(self, X_CM: np.ndarray, left: int, top: int, width: int, height: int) -> np.ndarray:
        """Part (height, width) float32 of a photo, 0 to 255, as the lens should see it; white beside the board."""
        over = (np.arange(_OVER * max(width, height)) + 0.5) / _OVER
        x, y = np.meshgrid((left + over[: _OVER * width]) / _STEP, (top + over[: _OVER * height]) / _STEP)
        rays = cv2.remap(self._rays, x.astype(np.float32), y.astype(np.float32), cv2.INTER_CUBIC)
        R, t = X_CM[:3, :3].astype(np.float32), X_CM[:3, 3].astype(np.float32)
        rays_M = cv2.transform(rays, R.T)
        with np.errstate(divide="ignore", invalid="ignore"):
            depth = (R[:, 2] @ t) / rays_M[..., 2:]
            places = (depth * rays_M[..., :2] - (t @ R)[:2]) * np.float32(self._scale) - np.float32(0.5)
        places = np.nan_to_num(places, nan=-1e4, posinf=-1e4, neginf=-1e4)
        fill = cv2.BORDER_CONSTANT
        drawn = cv2.remap(self._drawn, places, None, cv2.INTER_LINEAR, borderMode=fill, borderValue=255)  # type: ignore[call-overload]
        small = cv2.resize(drawn.astype(np.float32), (width, height), interpolation=cv2.INTER_AREA)
        blurred: np.ndarray = cv2.GaussianBlur(small, (0, 0), _BLUR)
        return blurred


def _shift(image: np.ndarray, drawing: np.ndarray, place: np.ndarray, half: int) -> np.ndarray | None:
    """Shift (2,) [px] of an image against a drawing around a place (2,) in OpenCV's pixels; None where they differ."""
    if (place < half + 1).any() or (place > np.array(image.shape[::-1]) - half - 2).any():
        return None
    size, middle = 2 * half + 1, np.round(place)
    seen = cv2.getRectSubPix(image, (size, size), (float(middle[0]), float(middle[1]))).ravel()
    shift = np.zeros(2)
    for _ in range(_ROUNDS):
        x, y = middle - shift
        wide = cv2.getRectSubPix(drawing, (size + 2, size + 2), (float(x), float(y)))
        by_x, by_y = 0.5 * (wide[1:-1, 2:] - wide[1:-1, :-2]), 0.5 * (wide[2:, 1:-1] - wide[:-2, 1:-1])
        A = np.column_stack([wide[1:-1, 1:-1].ravel(), -by_x.ravel(), -by_y.ravel(), np.ones(size * size)])
        gain, along_x, along_y, _ = np.linalg.lstsq(A, seen, rcond=None)[0]
        if gain <= 0.0:
            return None
        shift = shift + np.array([along_x, along_y]) / gain
        if not np.linalg.norm(shift) <= _FARTHEST:
            return None
    expected = A[:, 0]
    alike = float(np.corrcoef(expected, seen)[0, 1])
    return shift if alike >= _ALIKE else None
