# SPDX-License-Identifier: MIT
"""Shading of photos by the faces of a mesh: it tells a mug from one that is turned over."""

from collections.abc import Sequence

import cv2
import numpy as np
import trimesh

from pinwm_drake.masks.grabcut import grown
from pinwm_drake.masks.shots import Shot

_RIM, _FEWEST = 2, 30  # px left out along an outline; px of a photo that are worth a look
_PLAIN = 4.0  # variance of the lightness of a photo without any shading: noise


def unexplained(shots: Sequence[Shot], mesh: trimesh.Trimesh, X_WO: np.ndarray) -> float:
    """Share of the lightness's variance on an object that directions of its faces do not explain; 1 without shading.

    Light from far away gives a matt face a lightness that is nearly of second order in its normal. Each photo has an
    exposure of its own.

    Source: Ramamoorthi and Hanrahan, "An efficient representation for irradiance environment maps" (2001).
    """
    rows, values = [], []
    for shot in shots:
        depth = shot.depth(mesh, X_WO)
        seen = grown(np.isfinite(depth), -_RIM)
        if seen.sum() < _FEWEST:
            continue
        n = _normals(shot, depth)[seen]
        x, y, z = n.T
        terms = np.stack([x, y, z, x * y, y * z, z * x, x * x - y * y, 3 * z * z - 1], -1)
        light = cv2.cvtColor(shot.image, cv2.COLOR_RGB2LAB)[..., 0][seen].astype(float)
        rows.append(terms - terms.mean(axis=0))
        values.append(light - light.mean())
    if not rows:
        return 1.0
    A, b = np.concatenate(rows), np.concatenate(values)
    if np.mean(b**2) < _PLAIN:
        return 1.0
    return float(np.mean((b - A @ np.linalg.lstsq(A, b, rcond=None)[0]) ** 2) / np.mean(b**2))


def _normals(shot: Shot, depth: np.ndarray) -> np.ndarray:
    """Normals (H, W, 3), world, of a surface from its depths (H, W) [m]."""
    rows, columns = np.indices(depth.shape)
    z = np.where(np.isfinite(depth), depth, 0.0).astype(float)
    rays = np.stack([columns, rows, np.ones(depth.shape)], -1) @ np.linalg.inv(shot.K).T
    down, right = np.gradient(rays * z[..., None], axis=(0, 1))
    n = np.cross(down, right) @ shot.X_CW[:3, :3]
    return np.asarray(n / np.maximum(np.linalg.norm(n, axis=-1, keepdims=True), 1e-12))
