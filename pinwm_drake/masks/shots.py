# SPDX-License-Identifier: MIT
"""Photos with their cameras as arrays, and boxes of them at a size that is worth the work."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
import trimesh

from pinwm_drake.rendering.camera import Camera
from pinwm_drake.rendering.kernels.triangles import fill_depths, mark_triangles
from pinwm_drake.spatial.poses import Pose, inverse
from pinwm_drake.spatial.rigid import from_pose

_NEAR = 1e-3  # m; what is closer to the camera, or behind it, is not projected
_MARGIN = 3  # px, of a box


@dataclass(frozen=True, eq=False)
class Shot:
    """Photo and its camera.

    Attributes:
        name: Name of the photo in messages.
        image: (H, W, 3) uint8, sRGB.
        K: (3, 3) px, of a camera whose whole numbers are the middles of pixels, as OpenCV has them.
        X_CW: (4, 4) m, pose of the world in the camera, OpenCV axes.
    """

    name: str
    image: np.ndarray
    K: np.ndarray
    X_CW: np.ndarray

    @staticmethod
    def of(name: str, image: np.ndarray, camera: Camera, X_WC: Pose) -> "Shot":
        """Shot from a photo (H, W, 3) uint8, its camera and the pose of that in the world."""
        fx, fy, cx, cy = camera.intrinsics.tolist()
        K = np.array([[fx, 0.0, cx - 0.5], [0.0, fy, cy - 0.5], [0.0, 0.0, 1.0]])
        return Shot(name, image, K, from_pose(inverse(X_WC)))

    @property
    def P(self) -> np.ndarray:
        """Projection (3, 4): of a point in the world, column and row times depth, and depth [m]."""
        return self.K @ self.X_CW[:3]

    @property
    def p_WC(self) -> np.ndarray:
        """Place of the camera in the world (3,) [m]."""
        return -self.X_CW[:3, :3].T @ self.X_CW[:3, 3]

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width of the photo, px."""
        return self.image.shape[0], self.image.shape[1]

    def project(self, p_W: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Columns and rows (n, 2) [px] and depths (n,) [m] of points (n, 3) [m] of the world."""
        uvz = p_W @ self.P[:, :3].T + self.P[:, 3]
        return uvz[:, :2] / uvz[:, 2:], uvz[:, 2]

    def outline(self, mesh: trimesh.Trimesh, X_WO: np.ndarray) -> np.ndarray:
        """Mask (H, W) bool of the pixels that a mesh with pose X_WO (4, 4) [m] covers; empty where it is too near."""
        at, depths = self.project(mesh.vertices @ X_WO[:3, :3].T + X_WO[:3, 3])
        marked = np.zeros(self.shape, np.float32)
        if depths.min() > _NEAR:
            mark_triangles(at[mesh.faces] + 0.5, marked)
        return marked > 0

    def depth(self, mesh: trimesh.Trimesh, X_WO: np.ndarray) -> np.ndarray:
        """Depths (H, W) float32 [m] along the camera's axis of a mesh with pose X_WO (4, 4) [m]; inf beside it."""
        corners = mesh.vertices @ X_WO[:3, :3].T + X_WO[:3, 3]
        corners = corners @ self.X_CW[:3, :3].T + self.X_CW[:3, 3]
        intrinsics = np.array([[self.K[0, 0], self.K[1, 1], self.K[0, 2] + 0.5, self.K[1, 2] + 0.5]])
        depth = np.full((1, *self.shape), np.inf, np.float32)
        faces = np.ascontiguousarray(mesh.faces, np.int64)
        fill_depths(np.ascontiguousarray(corners[None]), faces, intrinsics, 0.01, depth, 0, 1)
        return depth[0]

    def around(self, p_W: np.ndarray, radius: float) -> tuple[int, int, int, int]:
        """Box (left, top, right, bottom) [px] around a ball in the world [m], within the photo; may be empty."""
        (at,), (depth,) = self.project(p_W[None])
        if depth <= radius:
            return 0, 0, self.shape[1], self.shape[0]
        reach = self.K[0, 0] * radius / np.sqrt(depth**2 - radius**2)
        return _clipped(at - reach, at + reach, self.shape)

    def box(self, p_W: np.ndarray, margin: float = 0.0) -> tuple[int, int, int, int]:
        """Box around points (n, 3) [m] of the world with a margin, a share of its size; see `around`."""
        at, depths = self.project(p_W)
        if depths.min() <= _NEAR:
            return 0, 0, self.shape[1], self.shape[0]
        low, high = at.min(axis=0), at.max(axis=0)
        wide = margin * (high - low).max() + _MARGIN
        return _clipped(low - wide, high + wide, self.shape)

    def close_up(self, box: tuple[int, int, int, int], longest: float) -> "CloseUp":
        """Return a box of the photo, scaled down so that no side has more than so many px."""
        left, top, right, bottom = box
        scale = min(1.0, longest / max(right - left, bottom - top))
        size = max(round((right - left) * scale), 1), max(round((bottom - top) * scale), 1)
        part = cv2.resize(self.image[top:bottom, left:right], size, interpolation=cv2.INTER_AREA)
        sx, sy = size[0] / (right - left), size[1] / (bottom - top)
        to = np.array([[sx, 0.0, (0.5 - left) * sx - 0.5], [0.0, sy, (0.5 - top) * sy - 0.5], [0.0, 0.0, 1.0]])
        return CloseUp(self.name, part, to @ self.K, self.X_CW, self, box)


@dataclass(frozen=True, eq=False)
class CloseUp(Shot):
    """Box of a photo, scaled.

    Attributes:
        whole: The photo.
        of_whole: The box, (left, top, right, bottom) [px].
    """

    whole: Shot
    of_whole: tuple[int, int, int, int]

    def pasted(self, mask: np.ndarray) -> np.ndarray:
        """Mask of the whole photo, bool, from that of the box (h, w) bool."""
        left, top, right, bottom = self.of_whole
        full = np.zeros(self.whole.shape, bool)
        part = cv2.resize(mask.astype(np.float32), (right - left, bottom - top), interpolation=cv2.INTER_LINEAR)
        full[top:bottom, left:right] = part > 0.5
        return full

    def cut(self, mask: np.ndarray) -> np.ndarray:
        """Mask of the box (h, w) bool from that of the whole photo, bool."""
        left, top, right, bottom = self.of_whole
        size = self.shape[1], self.shape[0]
        return cv2.resize(mask[top:bottom, left:right].astype(np.float32), size, interpolation=cv2.INTER_AREA) > 0.5

    def moved(self, offset: np.ndarray) -> "CloseUp":
        """Return the box with a camera whose picture lies elsewhere by an offset (2,) [px]."""
        K = self.K.copy()
        K[:2, 2] += offset
        return replace(self, K=K)


def aimed_at(shots: Sequence[Shot]) -> np.ndarray:
    """Return the point (3,) [m, world] that is nearest to all optical axes: where the photographer looked."""
    A, b = np.zeros((3, 3)), np.zeros(3)
    for shot in shots:
        across = np.eye(3) - np.outer(shot.X_CW[2, :3], shot.X_CW[2, :3])
        A, b = A + across, b + across @ shot.p_WC
    return np.linalg.lstsq(A, b, rcond=None)[0]


def _clipped(low: np.ndarray, high: np.ndarray, shape: tuple[int, int]) -> tuple[int, int, int, int]:
    limit = np.array([shape[1], shape[0]])
    (left, top), (right, bottom) = (
        np.clip(np.floor(low), 0, limit).astype(int).tolist(),
        np.clip(np.ceil(high) + 1, 0, limit).astype(int).tolist(),
    )
    return left, top, right, bottom
