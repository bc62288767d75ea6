"""Even choice of some of many."""

import torch
from torch import Tensor


def spaced(number: int, most: int) -> Tensor:
    """Indices (m,) of at most so many of a number of things, evenly spaced from the first to the last."""
    return torch.linspace(0, number - 1, min(most, number)).round().long()
