# SPDX-License-Identifier: MIT
"""Patches of a film around the place where a log has the pusher, for any offset of the log's clock.

A patch follows the pusher: its rows run along the projected vertical through the pusher's origin, from the pusher's
lower end to 0.1 m above that, where its stem is; its columns run across, and grow with the pusher in the image. Where
the offset is right, the pusher stands still in it.
"""

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass

import cv2
import numpy as np

from pinwm_drake.rendering.camera import Camera
from pinwm_drake.spatial.poses import Pose
from pinwm_drake.spatial.rotations import quaternion_to_matrix

NOISE = 5.0  # of 255 levels, of a pixel
_STEM = 0.1  # m above the pusher's lower end that look like it
_HALF = 10.0, 24.0  # px, half the width of a patch; larger pushers are sampled more coarsely
_MOST_ROWS = 60
_GRID, _SMOOTH = 0.002, 0.012  # s, between positions, and of the filter that takes the log's noise away
_DIFFERENCE = 0.02  # s, half the interval over which velocities are taken
_THUMBNAIL = 160  # px, width of the pictures whose differences are the film's motion
_QUIET = 4.0  # of 255 levels, of thumbnails: a change that is noise


@dataclass(frozen=True, eq=False)
class Seen:
    """Patches of some frames at one offset, and where and how they lie in the images.

    Attributes:
        patches: (n, rows, columns, c) float32, levels from 0 to 255.
        centre: (n, 2) [px], the projected origin of the pusher.
        axes: (n, 2, 2), unit vectors in the image across and along, of each frame.
    """

    patches: np.ndarray
    centre: np.ndarray
    axes: np.ndarray


class PusherFilm:
    """Film of a pusher, with its log, that can be looked at for any offset.

    Args:
        frames: n pictures (H, W, c) uint8.
        t: (n,) [s], by the film's clock.
        log_t: (m,) [s], by the log's clock, increasing.
        p_WP: (m, 3) [m], positions of the pusher.
        camera: Camera of the pictures.
        X_WC: Its pose (OpenCV axes); q (4,), p (3,) [m].
        bounds_P: (2, 3) [m], lowest and highest corner of the box around the pusher.

    Attributes:
        step: px between neighbours along (columns, rows) of a patch.
        taper: (columns,), weights that fall off beside the pusher.
    """

    def __init__(
        self,
        frames: Sequence[np.ndarray],
        t: np.ndarray,
        log_t: np.ndarray,
        p_WP: np.ndarray,
        camera: Camera,
        X_WC: Pose,
        bounds_P: np.ndarray,
    ) -> None:
        self.frames, self.t, self.log_t = frames, t, log_t
        self._R_CW = quaternion_to_matrix(X_WC.q).numpy().T
        self._p_WC, self._lens = X_WC.p.numpy(), camera.intrinsics.numpy()
        self.camera = camera
        self._grid = np.arange(log_t[0], max(log_t[-1], log_t[0] + 2 * _GRID), _GRID)
        self._way = _smooth(np.stack([np.interp(self._grid, log_t, p_WP[:, k]) for k in range(3)], axis=1))
        middle = self._way[len(self._way) // 2]
        radius = 0.5 * float(np.max(bounds_P[1, :2] - bounds_P[0, :2]))
        low, high = float(bounds_P[0, 2]), max(float(bounds_P[1, 2]), float(bounds_P[0, 2]) + _STEM)
        self._middle_depth = max(float(self._depth(middle[None])[0]), 1e-3)
        px = self._lens[0] / self._middle_depth  # for each metre
        half = float(np.clip(1.6 * radius * px + 4, *_HALF))
        reach = max(1.6 * radius * px + 4, half)
        ends = self.project(middle + np.array([[0, 0, low], [0, 0, high]]))
        length = float(np.linalg.norm(ends[1] - ends[0]))
        rows = int(np.clip(length / 2, 8, _MOST_ROWS))
        self._heights = np.linspace(low - 0.1 * (high - low), high, rows)
        self._across = np.linspace(-reach, reach, 2 * int(half) + 1)
        self.step = np.array([self._across[1] - self._across[0], max(length, 1.0) / (rows - 1)])
        self._rows = slice(None)
        self.taper = np.exp(-0.5 * (self._across / (0.55 * reach)) ** 2)

    def mirrored(self) -> "PusherFilm":
        """Return the film with its pictures mirrored left to right."""
        other = copy(self)
        other.frames = [np.ascontiguousarray(frame[:, ::-1]) for frame in self.frames]
        return other

    def some(self, number: int) -> "PusherFilm":
        """Return the film with at most so many of its frames, evenly chosen."""
        return self.part(np.unique(np.linspace(0, len(self.t) - 1, number).round().astype(int)))

    def part(self, which: np.ndarray) -> "PusherFilm":
        """Return the film with some of its frames, by their numbers `which` (k,)."""
        other = copy(self)
        other.frames, other.t = [self.frames[k] for k in which.tolist()], self.t[which]
        return other

    def band(self, number: int, of: int) -> "PusherFilm":
        """Return the film with the patches' rows of one of several bands, from below."""
        other, rows = copy(self), len(self._heights)
        other._rows = slice(number * rows // of, (number + 1) * rows // of)
        return other

    def _depth(self, p_W: np.ndarray) -> np.ndarray:
        return (p_W - self._p_WC) @ self._R_CW[2]

    def project(self, p_W: np.ndarray) -> np.ndarray:
        """Pixels (..., 2) of points (..., 3) [m]."""
        p_C = (p_W - self._p_WC) @ self._R_CW.T
        return p_C[..., :2] / np.maximum(p_C[..., 2:], 1e-3) * self._lens[:2] + self._lens[2:]

    def place(self, log_t: np.ndarray) -> np.ndarray:
        """Positions (n, 3) [m] of the pusher at times (n,) [s] of the log's clock."""
        return np.stack([np.interp(log_t, self._grid, self._way[:, k]) for k in range(3)], axis=-1)

    def velocity(self, log_t: np.ndarray) -> np.ndarray:
        """Velocities (n, 2) [px/s] of the pusher in the images at times (n,) [s] of the log's clock."""
        ends = (self.project(self.place(log_t + side * _DIFFERENCE)) for side in (1, -1))
        return np.subtract(*ends) / (2 * _DIFFERENCE)

    def look(self, log_t: np.ndarray, shift: np.ndarray | None = None) -> Seen:
        """Patches around the pusher as the log has it at times (n,) [s] of its clock, moved by `shift` (n, 2) [px]."""
        p_WP = self.place(log_t)
        column = np.zeros((len(self._heights), 3))
        column[:, 2] = self._heights
        line = self.project(p_WP[:, None] + column)
        along = line[:, -1] - line[:, 0]
        along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-9)
        across = np.stack([-along[:, 1], along[:, 0]], axis=1)
        size = self._middle_depth / np.maximum(self._depth(p_WP), 1e-3)  # of the pusher in the image
        points = line[:, :, None] + (size[:, None, None] * self._across)[..., None] * across[:, None, None] - 0.5
        points = points if shift is None else points + shift[:, None, None]
        maps = points.astype(np.float32)
        pictures = [
            cv2.remap(frame, one[..., 0], one[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
            for frame, one in zip(self.frames, maps, strict=True)
        ]
        patches = np.array(pictures, np.float32).reshape(*points.shape[:3], -1)
        return Seen(patches[:, self._rows], self.project(p_WP), np.stack([across, along], axis=1))

    def motion(self) -> np.ndarray:
        """Root (n - 1,) of the mean change from each picture to the next, beyond noise."""
        width = min(_THUMBNAIL, self.frames[0].shape[1])
        size = width, max(round(width * self.frames[0].shape[0] / self.frames[0].shape[1]), 1)
        small = [cv2.resize(frame, size, interpolation=cv2.INTER_AREA).astype(np.float32) for frame in self.frames]
        change = np.array(
            [np.maximum(np.abs(a - b) - _QUIET, 0).mean() for a, b in zip(small[1:], small, strict=False)]
        )
        return np.sqrt(np.maximum(change - np.percentile(change, 10), 0))


def _smooth(way: np.ndarray) -> np.ndarray:
    """Positions (g, 3) on the grid without the noise of the log."""
    reach = round(4 * _SMOOTH / _GRID)
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) * _GRID / _SMOOTH) ** 2)
    padded = np.pad(way, ((reach, reach), (0, 0)), mode="edge")
    return np.stack([np.convolve(padded[:, k], kernel / kernel.sum(), "valid") for k in range(3)], axis=1)


def path_weights(centre: np.ndarray) -> np.ndarray:
    """Weights (n,) of frames by the way [px] that the pusher's projection (n, 2) goes around each."""
    way = np.linalg.norm(np.diff(centre, axis=0), axis=1)
    weights = np.zeros(len(centre))
    weights[:-1] += 0.5 * way
    weights[1:] += 0.5 * way
    return weights


def box_of_way(
    p_WP: np.ndarray, camera: Camera, X_WC: Pose, bounds_P: np.ndarray, margin: int = 60
) -> tuple[int, int, int, int]:
    """Box of pixels (x, y, width, height), inside the image, around all that the pusher passes [m, world].

    It holds what a mirrored image would show there too: the image's middle column is its own.
    """
    R_CW = quaternion_to_matrix(X_WC.q).numpy().T
    corners = np.array([[0, 0, bounds_P[0, 2]], [0, 0, max(bounds_P[1, 2], bounds_P[0, 2] + _STEM)]])
    p_C = (p_WP[:, None] + corners - X_WC.p.numpy()).reshape(-1, 3) @ R_CW.T
    ahead = p_C[p_C[:, 2] > 0.01]
    if not len(ahead):
        return 0, 0, camera.width, camera.height
    lens = camera.intrinsics.numpy()
    pixels = ahead[:, :2] / ahead[:, 2:] * lens[:2] + lens[2:]
    size = np.array([camera.width, camera.height])
    low = np.clip(np.floor(pixels.min(0)) - margin, 0, size - 1).astype(int)
    high = np.clip(np.ceil(pixels.max(0)) + margin, low + 1, size).astype(int)
    if (high - low < 2 * margin // 3).any():  # it is not in view
        return 0, 0, camera.width, camera.height
    left = min(int(low[0]), camera.width - int(high[0]))
    return left, int(low[1]), camera.width - 2 * left, int(high[1] - low[1])
