# SPDX-License-Identifier: MIT
"""Poses of cameras. Camera frames have OpenCV's axes, which are Drake's: x right, y down, z forward."""

import math

import numpy as np
from pydrake.math import RigidTransform, RotationMatrix

from pinwm_drake.rendering.camera import Camera

_GOLDEN_ANGLE = math.pi * (3 - math.sqrt(5))
_LOWEST, _HIGHEST = math.radians(12), math.radians(80)  # rad, above the horizon


def look_at(p_WC: np.ndarray, p_WT: np.ndarray) -> RigidTransform:
    """Pose X_WC of a camera at p_WC (3,) m that looks at p_WT (3,) m, the world's z upwards in its image."""
    forward = (p_WT - p_WC) / np.linalg.norm(p_WT - p_WC)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    R_WC = np.column_stack([right, np.cross(forward, right), forward])
    return RigidTransform(RotationMatrix(R_WC), p_WC)


def around(p_WT: np.ndarray, distance: float, count: int, turn: float) -> list[RigidTransform]:
    """Poses of cameras all over the upper hemisphere around a point, evenly by area.

    Args:
        p_WT: (3,) m, world: point that they look at.
        distance: m, from that point.
        count: Number of cameras.
        turn: rad, turn of all cameras about the vertical.

    Returns:
        Their poses X_WC, from low to high.
    """
    heights = np.linspace(math.sin(_LOWEST), math.sin(_HIGHEST), count) if count > 1 else np.array([math.sqrt(0.5)])
    poses = []
    for k, height in enumerate(heights):
        angle, level = turn + k * _GOLDEN_ANGLE, math.sqrt(1 - height**2)
        poses.append(
            look_at(p_WT + distance * np.array([level * math.cos(angle), level * math.sin(angle), height]), p_WT)
        )
    return poses


def framed(points_W: np.ndarray, towards_W: np.ndarray, camera: Camera, margin: float) -> RigidTransform:
    """Pose of the nearest camera on a line of sight that sees all of some points.

    Args:
        points_W: (n, 3) m, world: the points.
        towards_W: (3,), world: direction from the points to the camera, of any length, not vertical.
        camera: Camera with intrinsics (4,) px, principal point in the middle.
        margin: Share of half the image that stays free on each side.

    Returns:
        Its pose X_WC; it looks at the middle of the points' box.
    """
    middle = 0.5 * (points_W.min(axis=0) + points_W.max(axis=0))
    towards_W = towards_W / np.linalg.norm(towards_W)
    R_WC = look_at(middle + towards_W, middle).rotation().matrix()
    points_C = (points_W - middle) @ R_WC  # from a camera in the middle
    focal = camera.intrinsics[:2].numpy()
    half = 0.5 * (1 - margin) * np.array([camera.width, camera.height])
    # focal |x| / (z + distance) <= half for every point.
    distance = float((np.abs(points_C[:, :2]) * focal / half - points_C[:, 2:]).max())
    return look_at(middle + distance * towards_W, middle)
