# SPDX-License-Identifier: MIT
"""White noise of measured poses, and rows that are none of the object."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch
from scipy.ndimage import median_filter
from torch import Tensor

from pinwm_drake.capture.episodes import ObjectPoses
from pinwm_drake.capture.measured_poses import MeasuredPoses
from pinwm_drake.identification.expansion import deviation
from pinwm_drake.spatial.poses import Pose
from pinwm_drake.twin.drift import per_radius

# Rows from which on the noise is told [m, of an angle at the object's rim]: the least of them, the least noise, and
# what is taken where there are fewer rows.
_ENOUGH, _LEAST, _USUAL = 5, 3e-5, 5e-4
# A row that is so many noises, and as far [m, rim], from the median of five is none of the object.
_WRONG, _FAR = 8.0, 5e-3


def track(poses: ObjectPoses) -> np.ndarray:
    """Rotation vectors [rad] and positions [m] (n, 6) of poses from the first of them."""
    X = Pose(torch.from_numpy(poses.q_WO), torch.from_numpy(poses.p_WO))
    return deviation(X, Pose(X.q[0], X.p[0])).numpy()


def white_noise(tracks: Sequence[tuple[np.ndarray, np.ndarray]], radius: float) -> Tensor:
    """White noise (6,) of tracks: times (n,) [s], and rotation vectors [rad] and positions [m] (n, 6).

    It is what a row differs by from the straight line between its neighbours, in the median.
    """
    differences = []
    for t, d in tracks:
        if len(t) >= 3:
            share = ((t[2:] - t[1:-1]) / (t[2:] - t[:-2]))[:, None]
            size = np.sqrt(1.0 + share**2 + (1.0 - share) ** 2)
            differences.append((d[1:-1] - share * d[:-2] - (1.0 - share) * d[2:]) / size)
    scale = per_radius(radius).numpy()
    if sum(map(len, differences)) < _ENOUGH:
        return torch.from_numpy(_USUAL * scale)
    found = 1.4826 * np.median(np.abs(np.concatenate(differences)), axis=0)
    # Axes that are alike share their noise: tilts, and those in the plane.
    found[:2], found[3:5] = np.sqrt(np.mean(found[:2] ** 2)), np.sqrt(np.mean(found[3:5] ** 2))
    return torch.from_numpy(np.maximum(found, _LEAST * scale))


def checked(table: MeasuredPoses, sigma: Tensor, radius: float) -> tuple[MeasuredPoses, list[int]]:
    """Table without rows that are far from their neighbours by noise sigma (6,), and the lines of these in the file."""
    d = track(table.poses)
    away = np.abs(d - median_filter(d, size=(5, 1), mode="nearest"))
    wrong = (away > np.maximum(_WRONG * sigma.numpy(), _FAR * per_radius(radius).numpy())).any(-1)
    if not wrong.any():
        return table, []
    poses = ObjectPoses(table.poses.t[~wrong], table.poses.p_WO[~wrong], table.poses.q_WO[~wrong])
    return replace(table, poses=poses), [table.lines[k] for k in np.flatnonzero(wrong)]
