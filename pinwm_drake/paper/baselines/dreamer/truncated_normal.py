"""Normal distribution cut off at -1 and 1, as the actor draws actions."""

import math

import torch
from torch import Tensor

_ROOT = math.sqrt(2.0)
_LOG = 0.5 * math.log(2.0 * math.pi * math.e)
_INSIDE = 1.0 - 1e-6  # largest action that is drawn


class TruncatedNormal:
    """Normal distribution of independent components within [-1, 1].

    Attributes:
        mean: (..., n) mean of the whole normal distribution, within [-1, 1]: the mode of the cut one.
        std: (..., n) standard deviation of the whole one.
    """

    def __init__(self, mean: Tensor, std: Tensor) -> None:
        self.mean, self.std = mean, std
        self._low, self._high = (-1.0 - mean) / std, (1.0 - mean) / std
        self._below = _cdf(self._low)
        self._inside = _cdf(self._high) - self._below

    def rsample(self) -> Tensor:
        """Sample (..., n), drawn by torch's generator, with a gradient to mean and standard deviation."""
        share = self._below + torch.rand_like(self.mean) * self._inside
        least = torch.finfo(share.dtype).eps  # a share of 0 or 1, which rounding makes, would be infinitely far
        found = self.mean + self.std * torch.special.ndtri(share.clamp(least, 1.0 - least))
        # Cut off by rounding only, which leaves the gradient as it is.
        return found + (found.clamp(-_INSIDE, _INSIDE) - found).detach()

    def entropy(self) -> Tensor:
        """Entropy (...) [nat] of all components together."""
        low, high = self._low * _density(self._low), self._high * _density(self._high)
        return (_LOG + self.std.log() + self._inside.log() + 0.5 * (low - high) / self._inside).sum(-1)


def _cdf(x: Tensor) -> Tensor:
    return 0.5 * (1.0 + torch.erf(x / _ROOT))


def _density(x: Tensor) -> Tensor:
    return (-0.5 * x * x).exp() / math.sqrt(2.0 * math.pi)
