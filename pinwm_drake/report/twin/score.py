# SPDX-License-Identifier: MIT
"""Errors of poses against recorded ones: a score, never part of a fit."""

from dataclasses import dataclass

import numpy as np

from pinwm_drake.capture.episodes import ObjectPoses

# How far a time may be outside of the recorded ones [s]: times printed with six decimals.
_ROUNDING = 1.5e-6


@dataclass(frozen=True, eq=False)
class PoseErrors:
    """Errors at the n times for which the truth is known."""

    t: np.ndarray  # (n,) [s]
    position: np.ndarray  # (n,) [m], distance of the origins of O in the horizontal plane
    rotation: np.ndarray  # (n,) [rad], geodesic angle between the orientations, 0 to pi

    def words(self) -> str:
        """Both errors in one line, mean and largest."""
        millimetres, degrees = 1e3 * self.position, np.degrees(self.rotation)
        return (
            f"position {millimetres.mean():.2f} mm on average, {millimetres.max():.2f} mm at most; "
            f"rotation {degrees.mean():.2f}° on average, {degrees.max():.2f}° at most"
        )


def pose_errors(poses: ObjectPoses, truth: ObjectPoses) -> PoseErrors | None:
    """Errors of poses at the times that a record covers; None where it covers none.

    Between two recorded poses the object moves straight and turns evenly.
    """
    from scipy.spatial.transform import Rotation, Slerp

    covered = (poses.t >= truth.t[0] - _ROUNDING) & (poses.t <= truth.t[-1] + _ROUNDING)
    if not covered.any():
        return None
    t = poses.t[covered]
    rotations = Rotation.from_quat(truth.q_WO, scalar_first=True)
    one = len(truth.t) == 1
    R_true = rotations if one else Slerp(truth.t, rotations)(np.clip(t, truth.t[0], truth.t[-1]))
    R = Rotation.from_quat(poses.q_WO[covered], scalar_first=True)
    p_true = np.stack([np.interp(t, truth.t, truth.p_WO[:, axis]) for axis in (0, 1)], -1)
    return PoseErrors(t, np.linalg.norm(poses.p_WO[covered, :2] - p_true, axis=1), (R_true.inv() * R).magnitude())
