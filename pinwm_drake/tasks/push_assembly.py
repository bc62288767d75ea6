# SPDX-License-Identifier: MIT
"""The push task's state from a network's estimate of the object, and from the pusher, whose position is known."""

import numpy as np
import torch
from torch import Tensor, nn

MOTION_SIZE = 7  # components of the state that are of the object alone


class PushAssembly(nn.Module):
    """Module from an estimate (B, 7) of the object and the pusher (B, 2) across its box to the state of `PushTask`.

    Attributes:
        estimate_size: Number of components that a network estimates: position, heading and velocity of the object.
        placing: (2, 2) float32, map of the pusher's observation into the goal's frame, in units of the state.
        origin: (2,) float32, middle of the pusher's box in the goal's frame, in units of the state.
        turning: (2, 2) float32, turn into the goal's frame, by the unit of lengths.
        goal: (2,) float32 m, world: place of the task's own goal.
        yaw: rad, yaw of the task's own goal.
    """

    estimate_size = MOTION_SIZE
    placing: Tensor
    origin: Tensor
    turning: Tensor
    goal: Tensor

    def __init__(self, goal: np.ndarray, length: float, low: np.ndarray, high: np.ndarray) -> None:
        """Build the map from the pusher's box to the goal's frame.

        Args:
            goal: (3,) x [m], y [m], yaw [rad], world.
            length: m, unit of lengths in the state.
            low: (2,) m, world: lower corner of the pusher's box.
            high: (2,) m, world: upper corner.
        """
        super().__init__()
        self.yaw = float(goal[2])
        c, s = np.cos(goal[2]), np.sin(goal[2])
        R_GW = np.array([[c, s], [-s, c]]) / length
        placing, origin = 0.5 * R_GW * (high - low), R_GW @ (0.5 * (low + high) - goal[:2])
        self.register_buffer("turning", torch.tensor(R_GW, dtype=torch.float32), persistent=False)
        self.register_buffer("goal", torch.tensor(goal[:2], dtype=torch.float32), persistent=False)
        self.register_buffer("placing", torch.tensor(placing, dtype=torch.float32), persistent=False)
        self.register_buffer("origin", torch.tensor(origin, dtype=torch.float32), persistent=False)

    def forward(
        self, estimate: Tensor, pusher: Tensor, place: Tensor | None = None, goal: Tensor | None = None
    ) -> Tensor:
        """State (B, 11) of `PushTask`, the goal's frame.

        Args:
            estimate: (B, 7): x and y, heading (of any length), velocity and rate of turn, in units of the state.
            pusher: (B, 2), x and y of the pusher across its box, -1 to 1.
            place: (B, 2) m, world: place from which the estimated x and y count; None for the task's own goal.
            goal: (B, 3) x [m], y [m], yaw [rad], world: goals of the episodes; None for the task's own.
        """
        if place is not None:
            estimate = torch.cat([estimate[:, :2] + (place - self.goal) @ self.turning.T, estimate[:, 2:]], 1)
        heading = nn.functional.normalize(estimate[:, 2:4])
        c, s = heading.unbind(1)
        p = pusher @ self.placing.T + self.origin
        x, y = (p - estimate[:, :2]).unbind(1)
        seen_from_object = torch.stack([c * x + s * y, c * y - s * x], 1)
        at, velocity, rate = estimate[:, :2], estimate[:, 4:6], estimate[:, 6:]
        if goal is not None:
            off, turn = (goal[:, :2] - self.goal) @ self.turning.T, self.yaw - goal[:, 2]
            at, p = turned(at - off, turn), turned(p - off, turn)
            heading, velocity = turned(heading, turn), turned(velocity, turn)
        return torch.cat([at, heading, velocity, rate, seen_from_object, p], 1)


def turned(vectors: Tensor, turn: Tensor) -> Tensor:
    """Vectors (B, 2), turned by angles (B,) rad."""
    c, s = turn.cos(), turn.sin()
    x, y = vectors.unbind(1)
    return torch.stack([c * x - s * y, s * x + c * y], 1)
