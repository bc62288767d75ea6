# SPDX-License-Identifier: MIT
"""Similarity from the world in which images were posed to that of the capture (metres, z up)."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from pinwm_drake.capture.transforms import require_last_row
from pinwm_drake.documents import read_yaml
from pinwm_drake.spatial.poses import Pose
from pinwm_drake.spatial.rotations import matrix_to_quaternion, quaternion_to_matrix

_ORTHONORMAL = 1e-4
_SCALES = (1e-6, 1e6)


@dataclass(frozen=True, eq=False)
class Similarity:
    """Similarity p_W = scale R_WS p_S + p_WS, from the source's world S to the capture's world W."""

    scale: float  # m for each unit of S
    R_WS: np.ndarray  # (3, 3)
    p_WS: np.ndarray  # (3,) [m]

    def pose(self, X_SC: Pose) -> Pose:
        """Pose in W of a camera whose pose in S, in its units, is X_SC; q (4,), p (3,) [m]."""
        R_WC = self.R_WS @ quaternion_to_matrix(X_SC.q).numpy()
        p_WC = self.scale * self.R_WS @ X_SC.p.numpy() + self.p_WS
        return Pose(matrix_to_quaternion(torch.from_numpy(R_WC)), torch.from_numpy(p_WC))


def scaled_world(scale: float = 1.0) -> Similarity:
    """Return the similarity that changes the unit of length only: `scale` m for each unit of the source."""
    return Similarity(scale, np.eye(3), np.zeros(3))


def read_similarity(path: Path, scale: float = 1.0) -> Similarity:
    """Read a similarity from a file.

    Args:
        path: File in YAML or JSON: four rows of four numbers, or those under the key `matrix`; the capture's world from
            the source's, metres.
        scale: m for each unit of the source, besides that of the matrix.

    Raises:
        InputError: The file cannot be read, or the matrix is no rotation times a positive scale.
    """
    document = read_yaml(path)
    entry = document if isinstance(document.value, list) else document["matrix"]
    matrix = entry.numbers(4, 4)
    require_last_row(entry, matrix)
    with np.errstate(over="ignore", invalid="ignore"):
        own = float(np.cbrt(np.linalg.det(matrix[:3, :3])))
    if not _SCALES[0] <= own <= _SCALES[1]:
        raise entry.refusal("a rotation times a positive scale", f"a matrix of scale {own:.3g}")
    R_WS = matrix[:3, :3] / own
    error = float(np.abs(R_WS.T @ R_WS - np.eye(3)).max())
    if not error <= _ORTHONORMAL:
        raise entry.refusal(f"a rotation times one scale, to {_ORTHONORMAL:g}", f"axes {error:.2g} off")
    return Similarity(own * scale, R_WS, matrix[:3, 3])
