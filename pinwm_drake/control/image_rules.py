# SPDX-License-Identifier: MIT
"""Rules that tell a camera's image of the object from one that cannot be: blind, implausible or frozen."""

import hashlib
from dataclasses import dataclass

import numpy as np

from pinwm_drake.learning.spec import CameraSpec

# Shares of the least and of the most pixels that the object had when its policy was exported. An arm may hide a part of
# it, so that less is seen; more is not.
_LEAST, _MOST = 0.2, 1.7
_OUTSIDE = 0.1  # m, by which the object may lie beyond the pusher's box
_JUMP = 0.05  # m, by which the middle of what is seen may move besides what the fastest pusher does to it
_FASTER = 2.0  # times the pusher's speed, of the middle of an object that it turns


@dataclass(frozen=True)
class Sight:
    """Record of an image.

    Attributes:
        time: s, when it was taken.
        pixels: Number of pixels that show the object: all that are not white.
        p_W: (2,) m, world: x and y of the middle of these pixels on the floor; NaN where there are none.
        digest: SHA-256 of the pixels.
    """

    time: float
    pixels: int
    p_W: tuple[float, float]
    digest: bytes


class ImageRules:
    """Rules for the images of one camera, by a policy's specification.

    An image is blind where it shows fewer pixels of the object than a fifth of the least that it had in the golden
    samples, or none. It is implausible with more than 1.7 times the most; with the object 0.1 m or more outside of the
    pusher's box in training; or where the middle of what is seen has moved farther than 50 mm and twice the way of the
    fastest pusher. It is frozen where all pixels are those of the image before, though the pusher moves: the noise of a
    real camera forbids that.

    Args:
        camera: Camera of the images.
        height: m, world: z of the plane that pixels are projected onto.
        box: Least and largest x and y [m, world] of the pusher in training.
        max_speed: m/s, of the pusher.
        pixels: Least and largest number of pixels of the object in the golden samples; None where not known.
        live: Flag: the images are a real camera's, whose noise makes each another one.
    """

    def __init__(
        self,
        camera: CameraSpec,
        height: float,
        box: tuple[tuple[float, float], tuple[float, float]],
        max_speed: float,
        pixels: tuple[int, int] | None,
        live: bool,
    ) -> None:
        self._camera, self._max_speed, self._live = camera, max_speed, live
        low, high = box
        least, most = (1, camera.width * camera.height) if pixels is None else pixels
        self._least, self._most = max(_LEAST * least, 1.0), _MOST * most
        self._low, self._high = np.array(low) - _OUTSIDE, np.array(high) + _OUTSIDE
        # By the quaternion itself: a robot's controller does without scipy.
        q_WC = np.array(camera.q_WC) / np.linalg.norm(camera.q_WC)
        self._w, self._u = q_WC[0], q_WC[1:]
        self._height = height

    def sight(self, rgb: np.ndarray, time: float) -> Sight:
        """Record of an image.

        Args:
            rgb: (height, width, 3) uint8, of the camera's size: the object where it is seen, white elsewhere.
            time: s, when it was taken.
        """
        seen = (rgb != 255).any(axis=2)
        pixels = int(seen.sum())
        p_W = (float("nan"), float("nan"))
        if pixels:
            v, u = (float(index.mean()) + 0.5 for index in np.nonzero(seen))
            p_W = self._on_floor(u, v)
        return Sight(time, pixels, p_W, hashlib.sha256(rgb.tobytes()).digest())

    def fault(self, sight: Sight, last: Sight | None, moving: bool) -> str:
        """Fault of an image in words; empty if there is none.

        Args:
            sight: The image.
            last: The image before it, which was taken earlier; None for the first.
            moving: Flag: the pusher is commanded to move.
        """
        if sight.pixels < self._least:
            return f"image is blind: {sight.pixels} px of the object; allowed: {self._least:.0f} or more"
        if sight.pixels > self._most:
            return f"image is implausible: {sight.pixels} px of the object; allowed: at most {self._most:.0f}"
        p_W = np.array(sight.p_W)
        if not ((self._low <= p_W).all() and (p_W <= self._high).all()):
            where = f"({p_W[0]:.3f}, {p_W[1]:.3f}) m"
            return f"image is implausible: the object at {where}; allowed: within {_OUTSIDE:g} m of the pusher's box"
        if last is None:
            return ""
        if self._live and moving and sight.digest == last.digest:
            return f"image is frozen: the same pixels as {sight.time - last.time:.3f} s before, while the pusher moves"
        way = float(np.linalg.norm(p_W - last.p_W)) if last.pixels else 0.0
        farthest = _JUMP + _FASTER * self._max_speed * (sight.time - last.time)
        if way > farthest:
            allowed = f"{1e3 * farthest:.0f} mm in {sight.time - last.time:.3f} s"
            return f"image is implausible: the object jumped by {1e3 * way:.0f} mm; allowed: {allowed}"
        return ""

    def _on_floor(self, u: float, v: float) -> tuple[float, float]:
        """Point x, y [m, world] of the plane that a pixel (u, v) shows; NaN where it shows none."""
        camera = self._camera
        p_C = np.array([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, 1.0])
        ray = p_C + 2.0 * np.cross(self._u, np.cross(self._u, p_C) + self._w * p_C)
        drop = self._height - camera.p_WC[2]
        if ray[2] * drop <= 0.0:
            return float("nan"), float("nan")
        x, y = np.array(camera.p_WC[:2]) + ray[:2] * drop / ray[2]
        return float(x), float(y)
