# SPDX-License-Identifier: MIT
"""Accuracy of a calibration: how far from its true place a point of the workspace is seen, and the table.

Focal length and the camera's distance go together, so that neither says how good a calibration is. A point that is seen
one pixel off is off by that pixel's width at its depth, across the ray.
"""

from dataclasses import dataclass

import numpy as np
from scipy.stats import f as fisher
from scipy.stats import t as student

from pinwm_drake.capture.lens import Lens
from pinwm_drake.spatial.rigid import apply, cross, inverse
from pinwm_drake.station.solve import Solution

CONFIDENCE = 0.95


@dataclass(frozen=True, eq=False)
class Accuracy:
    """Accuracy of a calibration, 95 %.

    Attributes:
        median, worst: Distance within which a point is seen, for the median and the worst point of the workspace, m.
        height: Half the interval of the table's height in the middle of the workspace, m.
        tilt: Largest angle between the table's normal and its true one, rad.
    """

    median: float
    worst: float
    height: float
    tilt: float

    def words(self) -> str:
        """How well points of the workspace are seen, in words."""
        return (
            f"points of the workspace are seen within {1e3 * self.median:.2f} mm of their places, the worst within "
            f"{1e3 * self.worst:.2f} mm (95 %)"
        )


def degrees_of_freedom(solution: Solution) -> float:
    """Number of redundant values that the robot told: all errors of a calibration come from these above all."""
    poses = sum(block.trusted for block in solution.bundle.told)
    return float(max(6 * poses - 12, 1))


def gripper_poses(solution: Solution) -> list[np.ndarray | None]:
    """Poses X_BE (4, 4) from which a camera in the hand looks; None alone for one that stands still."""
    if solution.mount == "fixed":
        return [None]
    return [block.X for block in solution.bundle.told]


def seen_spread(solution: Solution, p_B: np.ndarray, X_BE: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
    """Covariances of where points are seen, of those that are within the image.

    Args:
        solution: The calibration.
        p_B: (N, 3) m, points in the robot's base.
        X_BE: (4, 4) pose of the gripper, for a camera in the hand.

    Returns:
        Indices (n,) of the points within the image, and their covariances (n, 2, 2) [px^2].
    """
    p_G = p_B if X_BE is None else apply(inverse(X_BE), p_B)
    p_C = apply(inverse(solution.camera.X), p_G)
    shown = np.flatnonzero(within(solution.lens, p_C))
    _, by_point, by_lens = solution.lens.project_with_jacobian(p_C[shown])
    motions = np.concatenate([np.broadcast_to(-np.eye(3), (len(shown), 3, 3)), cross(p_C[shown])], -1)
    J = np.concatenate([by_lens, by_point @ motions], -1)
    columns = [*range(by_lens.shape[-1]), *range(solution.camera.columns.start, solution.camera.columns.stop)]
    return shown, J @ solution.covariance[np.ix_(columns, columns)] @ J.transpose(0, 2, 1)


def within(lens: Lens, p_C: np.ndarray) -> np.ndarray:
    """Flags (N,): points p_C (N, 3) [m] are in front of a camera and within its image."""
    ahead = p_C[:, 2] > 1e-3
    pixels = lens.project(np.where(ahead[:, None], p_C, [0.0, 0.0, 1.0]))
    inside: np.ndarray = ahead & (pixels >= 0.0).all(1) & (pixels <= [lens.width, lens.height]).all(1)
    return inside


def across(lens: Lens, X_CB: np.ndarray, p_B: np.ndarray) -> np.ndarray:
    """Matrices (N, 3, 2) [m/px] from errors in the image to the shortest motions of points p_B (N, 3) [m]."""
    by_point = lens.project_with_jacobian(apply(X_CB, p_B))[1] @ X_CB[:3, :3]
    return np.linalg.pinv(by_point)


def accuracy(solution: Solution, p_B: np.ndarray, middle_B: np.ndarray) -> Accuracy:
    """Accuracy of a calibration.

    Args:
        solution: The calibration.
        p_B: (N, 3) m, points of the workspace in the robot's base.
        middle_B: (3,) m, middle of the workspace.
    """
    redundancy = degrees_of_freedom(solution)
    plane = np.sqrt(2.0 * fisher.ppf(CONFIDENCE, 2, redundancy))  # standard deviations of an ellipse that holds 95 %
    radii = [np.array([np.nan])]
    for X_BE in gripper_poses(solution):
        shown, spread = seen_spread(solution, p_B, X_BE)
        X_BC = solution.camera.X if X_BE is None else X_BE @ solution.camera.X
        M = across(solution.lens, inverse(X_BC), p_B[shown])
        radii.append(plane * np.sqrt(np.linalg.eigvalsh(M @ spread @ M.transpose(0, 2, 1))[:, -1]))
    every = np.concatenate(radii)[1:]
    every = every if len(every) else np.array([np.nan])
    C = solution.covariance[solution.table.columns, solution.table.columns]
    q = apply(inverse(solution.table.X), middle_B)
    up = np.array([1.0, q[1], -q[0]])  # of the middle, by motions v_z, w_x, w_y of the table
    height = float(student.ppf(0.5 + 0.5 * CONFIDENCE, redundancy) * np.sqrt(up @ C @ up))
    tilt = float(plane * np.sqrt(np.linalg.eigvalsh(C[1:, 1:])[-1]))
    return Accuracy(float(np.median(every)), float(every.max()), height, tilt)


def scale_by_robot(solution: Solution, reading: float) -> tuple[float, float]:
    """Scale of the board by the robot's motions alone, against the ruler's reading, and its standard deviation.

    Args:
        solution: The calibration.
        reading: Standard deviation of the ruler's reading, as a share.
    """
    at = solution.bundle.num_lens
    both = float(solution.covariance[at, at])
    own = 1.0 / max(1.0 / both - 1.0 / reading**2, 1e-12)
    return float(own * (solution.bundle.scale / both - 1.0 / reading**2)), float(np.sqrt(own))
