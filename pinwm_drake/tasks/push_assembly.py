"""The push task's state from what a network estimates of the object, and from the pusher, whose position is known."""

import numpy as np
import torch
from torch import Tensor, nn

MOTION_SIZE = 7  # of the state, without the pusher


class PushAssembly(nn.Module):
    """From an estimate (B, 7) of the object and the pusher (B, 2) across its box to the state (B, 11) of `PushTask`.

    Attributes:
        estimate_size: Numbers that a network estimates: position, heading and velocity of the object.
    """

    estimate_size = MOTION_SIZE
    placing: Tensor
    origin: Tensor

    def __init__(self, goal: np.ndarray, length: float, low: np.ndarray, high: np.ndarray) -> None:
        """Builds the map from the pusher's box to the goal's frame.

        Args:
            goal: (3,) x [m], y [m], yaw [rad], world.
            length: m, length that stands for 1 in the state.
            low: (2,) m, world: lower corner of the pusher's box.
            high: (2,) m, world: upper corner.
        """
        super().__init__()
        c, s = np.cos(goal[2]), np.sin(goal[2])
        R_GW = np.array([[c, s], [-s, c]]) / length
        placing, origin = 0.5 * R_GW * (high - low), R_GW @ (0.5 * (low + high) - goal[:2])
        self.register_buffer("placing", torch.tensor(placing, dtype=torch.float32), persistent=False)
        self.register_buffer("origin", torch.tensor(origin, dtype=torch.float32), persistent=False)

    def forward(self, estimate: Tensor, pusher: Tensor) -> Tensor:
        """The state (B, 11).

        Args:
            estimate: (B, 7): x and y, heading (of any length), velocity and turn, in units of the state.
            pusher: (B, 2), x and y across its box, -1 to 1.
        """
        heading = nn.functional.normalize(estimate[:, 2:4])
        c, s = heading.unbind(1)
        p = pusher @ self.placing.T + self.origin
        x, y = (p - estimate[:, :2]).unbind(1)
        seen_from_object = torch.stack([c * x + s * y, c * y - s * x], 1)
        return torch.cat([estimate[:, :2], heading, estimate[:, 4:], seen_from_object, p], 1)
