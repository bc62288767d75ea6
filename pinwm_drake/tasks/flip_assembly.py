# SPDX-License-Identifier: MIT
"""The flip task's state from a network's estimate of the object, and from the pusher, whose position is known."""

import numpy as np
import torch
from torch import Tensor, nn

MOTION_SIZE = 15  # components of the state that are of the object alone


class FlipAssembly(nn.Module):
    """Module from an estimate (B, 15) of the object and the pusher (B, 3) across its box to the state of `FlipTask`.

    Attributes:
        estimate_size: Number of components that a network estimates: position, axes and velocities of the object.
        scale: (3,) float32, half the sides of the pusher's box, in units of the state.
        middle: (3,) float32, middle of the pusher's box, from the state's origin, in the same units.
        origin: (2,) float32, x and y of that origin in the world, in the same units.
    """

    estimate_size = MOTION_SIZE
    scale: Tensor
    middle: Tensor
    origin: Tensor

    def __init__(self, origin: np.ndarray, length: float, low: np.ndarray, high: np.ndarray, *, round: bool) -> None:
        """Build the map from the pusher's box to the state's frame.

        Args:
            origin: (3,) m, world: point from which the state counts; see `FlipTask.origin`.
            length: m, unit of lengths in the state.
            low: (3,) m, world: lower corner of the pusher's box.
            high: (3,) m, world: upper corner.
            round: Flag: the object is round about the axis that is to point up, so that there is no second one.
        """
        super().__init__()
        middle = 0.5 * (np.asarray(low) + high) - origin
        self._round, self._length = round, length
        self.register_buffer("scale", torch.tensor(0.5 * (high - low) / length).float(), persistent=False)
        self.register_buffer("middle", torch.tensor(middle / length).float(), persistent=False)
        self.register_buffer("origin", torch.tensor(origin[:2] / length).float(), persistent=False)

    def forward(self, estimate: Tensor, pusher: Tensor, place: Tensor | None = None) -> Tensor:
        """State (B, 18) of `FlipTask`.

        Args:
            estimate: (B, 15): position, both axes (of any length) and velocities, in units of the state.
            pusher: (B, 3), position of the pusher across its box, -1 to 1.
            place: (B, 2) m, world: x and y from which the estimated position counts; None for the state's origin.
        """
        if place is not None:
            estimate = torch.cat([estimate[:, :2] + place / self._length - self.origin, estimate[:, 2:]], 1)
        up = nn.functional.normalize(estimate[:, 3:6])
        side = torch.zeros_like(up) if self._round else nn.functional.normalize(estimate[:, 6:9])
        away = pusher * self.scale + self.middle - estimate[:, :3]
        return torch.cat([estimate[:, :3], up, side, estimate[:, 9:], away], 1)
