# SPDX-License-Identifier: MIT
"""The frame of the robot against that in which the object is seen: one constant offset for all pushes of a capture.

A robot's log counts from its base, a camera or motion capture from a frame of its own. What calibration leaves between
both is a shift and a turn of the pusher's log: `frame_x`, `frame_y` [m] and `frame_yaw` [rad], about the pivot, the
point at which `capture.yaml` has the object. The world is that of the object.
"""

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from pinwm_drake.capture.episode_tables import PusherTrajectory
from pinwm_drake.scene import PusherMotion
from pinwm_drake.spatial.poses import Pose
from pinwm_drake.spatial.rotations import (
    quaternion_exp,
    quaternion_multiply,
    quaternion_to_matrix,
    rotate,
)
from pinwm_drake.twin.twin import Draws, Twin

FRAME = ("frame_x", "frame_y", "frame_yaw")
# Correlation from which on frame and centre of mass are not told apart, and the least spread of the frame that counts.
_ALIKE, _LEAST = 0.5, 5e-4
_DIRECTIONS = 36  # of the half circle, in which correlations are looked at


def moved_pose(X: Pose, frame: Tensor, pivot: Tensor) -> Pose:
    """Poses q (..., 4), p (..., 3) [m] of the log in the object's world, by frames (..., 3); differentiable."""
    turn, shift = _turn_and_shift(frame)
    return Pose(quaternion_multiply(turn, X.q), pivot + rotate(turn, X.p - pivot) + shift)


def moved_motion(motion: PusherMotion, frame: Tensor, pivot: Tensor) -> PusherMotion:
    """Motions of the log in W worlds, moved by a frame (W, 3) of each about a pivot (3,) [m]; differentiable."""
    W, steps = len(frame), len(motion.V_WP)
    X = moved_pose(Pose(motion.q_WP.expand(W, 4), motion.p_WP.expand(W, 3)), frame, pivot)
    turn, _ = _turn_and_shift(frame)
    V = motion.V_WP if motion.V_WP.ndim == 3 else motion.V_WP[:, None]
    V = V.expand(steps, W, 6)
    turns = turn.expand(steps, W, 4)
    return PusherMotion(X.q, X.p, torch.cat([rotate(turns, V[..., :3]), rotate(turns, V[..., 3:])], -1))


def in_world(twin: Twin, trajectory: PusherTrajectory) -> PusherTrajectory:
    """Return a log of the robot in the world in which a twin's object is, by the twin's estimates of the frame."""
    frame = frame_of(twin)
    if not bool(frame.any()):
        return trajectory
    X = Pose(torch.from_numpy(trajectory.q_WP), torch.from_numpy(trajectory.p_WP))
    X = moved_pose(X, frame, pivot_of(twin))
    turn, _ = _turn_and_shift(frame)
    R = quaternion_to_matrix(turn).numpy()
    force = None if trajectory.force_W is None else trajectory.force_W @ R.T
    return replace(trajectory, p_WP=X.p.numpy(), q_WP=X.q.numpy(), v_WP=trajectory.v_WP @ R.T, force_W=force)


def frame_of(twin: Twin) -> Tensor:
    """Frame (3,) of a twin by its estimates: x, y [m] and yaw [rad]; 0 where it has none."""
    values = [twin.nuisance[name].value if name in twin.nuisance else 0.0 for name in FRAME]
    return torch.tensor(values, dtype=torch.float64)


def drawn_frames(twin: Twin, rows: np.ndarray) -> Tensor:
    """Frames (W, 3) by rows (W,) of a twin's draws; its estimates where it has no draws of them."""
    frames = frame_of(twin).repeat(len(rows), 1)
    for k, name in enumerate(FRAME):
        if twin.draws is not None and name in twin.draws.names:
            frames[:, k] = torch.from_numpy(twin.draws.column(name)[rows])
    return frames


def pivot_of(twin: Twin) -> Tensor:
    """Point (3,) [m] about which a twin's frame turns: where its capture has the object; else the origin."""
    start: Any = twin.provenance.get("start")
    try:
        p = [float(value) for value in start["written"]["p"]]
    except (KeyError, TypeError, ValueError):
        p = []
    return torch.tensor(p if len(p) == 3 else [0.0, 0.0, 0.0], dtype=torch.float64)


@dataclass(frozen=True)
class Confusion:
    """Direction in the floor's plane along which draws of frame and centre of mass go together.

    Attributes:
        angle: Of the direction, from the world's x towards y, 0 to pi [rad].
        correlation: Between frame and centre of mass along it, -1 to 1.
        spread: Standard deviation of the frame along it, m.
    """

    angle: float
    correlation: float
    spread: float

    @property
    def reason(self) -> str:
        """What is not known, in one line."""
        return (
            f"frame and centre of mass cannot be told apart along {math.degrees(self.angle):.0f}° (0° is +x, 90° is "
            f"+y): correlation {self.correlation:.2f}, frame ±{1.96e3 * self.spread:.1f} mm"
        )

    @property
    def words(self) -> str:
        """The same, and what to do."""
        return f"{self.reason}; push another face, as `pinwm next-push` proposes"


def confusion(draws: Draws | None, q_WO: Tensor) -> Confusion | None:
    """Direction in which draws of frame and centre of mass are alike; None where they are told apart.

    Args:
        draws: Draws of a twin, the centre of mass in the axes of O.
        q_WO: (4,), orientation of the object in the pushes.
    """
    names = ("frame_x", "frame_y", "center_x", "center_y", "center_z")
    if draws is None or any(name not in draws.names for name in names):
        return None
    values = np.stack([draws.column(name) for name in names], -1)
    frame, center = values[:, :2], (values[:, 2:] @ quaternion_to_matrix(q_WO).numpy().T)[:, :2]
    found = []
    for angle in np.pi * np.arange(_DIRECTIONS) / _DIRECTIONS:
        u = np.array([math.cos(angle), math.sin(angle)])
        one, other = frame @ u, center @ u
        if one.std() > _LEAST and other.std() > 0.0:
            found.append(Confusion(float(angle), float(np.corrcoef(one, other)[0, 1]), float(one.std())))
    alike = [one for one in found if abs(one.correlation) > _ALIKE]
    return max(alike, key=lambda one: abs(one.correlation) * one.spread, default=None)


def _turn_and_shift(frame: Tensor) -> tuple[Tensor, Tensor]:
    """Quaternions (..., 4) and shifts (..., 3) of frames (..., 3)."""
    zero = torch.zeros_like(frame[..., 0])
    turn = quaternion_exp(torch.stack([zero, zero, frame[..., 2]], -1))
    return turn, torch.stack([frame[..., 0], frame[..., 1], zero], -1)
