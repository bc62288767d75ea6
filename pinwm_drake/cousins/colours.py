# SPDX-License-Identifier: MIT
"""Random colours of cousins.

Every coefficient w of a surfel's spherical harmonics is drawn from w (1 - delta) to w (1 + delta). A colour that would
leave [0, 1] in some direction is moved back towards the twin's, all coefficients of one surfel and channel by the same
share, until it does not; where the twin's own leaves [0, 1], the cousin's goes no further. So each coefficient stays in
its interval.

Directions are 512 points of a Fibonacci sphere; none is farther than 0.1206 rad from one of them. A polynomial of
degree 3 that stays within +-h there is within +-h / cos(3 * 0.1206) = 1.069 h everywhere, so that between them a colour
can be 3.5 % of its range beyond (0.1 % is the most that was seen). There the renderer cuts it.
"""

import math

import numpy as np
import torch

from pinwm_drake.rendering.harmonics import harmonics
from pinwm_drake.rendering.surfels import Surfels

_DIRECTIONS = 512
_CHUNK = 512  # colours that are evaluated in all directions at once
_NEAR = 1e-4  # in units of a colour, 0 to 1: more than the rounding error of single precision


class ColourDraw:
    """Colours of one twin, and the limits that each has in a draw."""

    def __init__(self, surfels: Surfels) -> None:
        """Compute the range of every surfel's colours over all directions; sh is (N, K, 3)."""
        self._sh = surfels.sh.detach().to(torch.float32).numpy()
        bands = [2 * band + 1 for band in range(surfels.degree + 1)]
        # The largest value of a band's harmonics with coefficients of norm 1, by the addition theorem.
        self._reach = np.sqrt(np.array(bands, np.float32) / np.float32(4.0 * math.pi))
        self._starts = np.cumsum([0, *bands[:-1]])
        self._basis = harmonics(_directions(_DIRECTIONS), surfels.degree).numpy().T
        self._twin = rows = np.ascontiguousarray(self._rows(self._sh))
        # A colour that is the same in all directions needs one evaluation alone; many are.
        self._constant = np.logical_not(rows[:, 1:].any(axis=1))
        ends = [part @ self._basis + 0.5 for part in np.split(rows, range(_CHUNK, len(rows), _CHUNK))]
        self._low: np.ndarray = np.concatenate([part.min(1) for part in ends])
        self._high: np.ndarray = np.concatenate([part.max(1) for part in ends])
        self._floor: np.ndarray = np.minimum(self._low, 0.0)
        self._ceiling: np.ndarray = np.maximum(self._high, 1.0)

    def draw(self, generator: np.random.Generator, delta: float) -> tuple[torch.Tensor, float]:
        """Draws the colours of a cousin.

        Args:
            generator: Source of randomness; drawn from a fixed number of times.
            delta: Relative half-width of each coefficient's range, 0 or more, less than 1.

        Returns:
            (N, K, 3) float32 harmonics, and the share of the N x 3 colours that had to be moved back.
        """
        change = self._sh * (np.float32(delta) * (2.0 * generator.random(self._sh.shape, np.float32) - 1.0))
        share = self._share(change)
        moved = float((share < 1.0).mean())
        if moved:
            change *= share.reshape(len(self._sh), 1, 3)
        return torch.from_numpy(self._sh + change), moved

    def _share(self, change: np.ndarray) -> np.ndarray:
        """Shares (3 N,), 0 to 1, of a change (N, K, 3) of the harmonics that each colour can take."""
        norms = np.sqrt(np.add.reduceat(change * change, self._starts, axis=1))
        most = np.tensordot(self._reach, norms, axes=(0, 1)).ravel() + _NEAR
        share = np.ones(len(most))
        near = np.flatnonzero((self._high + most > self._ceiling) | (self._low - most < self._floor))
        turning, changes = near[~self._constant[near]], self._rows(change)
        self._limit(share, near[self._constant[near]], changes, self._basis[:, :1])
        for at in np.split(turning, range(_CHUNK, len(turning), _CHUNK)):
            self._limit(share, at, changes, self._basis)
        return share.astype(np.float32)

    def _limit(self, share: np.ndarray, at: np.ndarray, changes: np.ndarray, basis: np.ndarray) -> None:
        """Lowers the shares (3 N,) of the colours `at` (n,) to those that their limits leave in some directions.

        `changes` (3 N, K) are those of all colours' harmonics, `basis` (K, directions) the harmonics to look from.
        """
        after = (self._twin[at] + changes[at]) @ basis.astype(np.float32) + np.float32(0.5)
        at = at[(after.max(1) > self._ceiling[at] - _NEAR) | (after.min(1) < self._floor[at] + _NEAR)]
        # In double, so that a sum in another order, on another machine, gives the same number in single precision.
        before, by = (rows[at].astype(float) @ basis for rows in (self._twin, changes))
        room = np.abs(np.where(by > 0.0, self._ceiling[at, None] - 0.5, self._floor[at, None] - 0.5) - before)
        by = np.abs(by)
        share[at] = np.divide(room, by, out=np.ones_like(by), where=by > room).min(1)

    @staticmethod
    def _rows(sh: np.ndarray) -> np.ndarray:
        """Harmonics (N, K, 3) as rows (3 N, K): red, green, blue of one surfel, then of the next."""
        rows: np.ndarray = sh.transpose(0, 2, 1).reshape(-1, sh.shape[1])
        return rows


def _directions(number: int) -> torch.Tensor:
    """Return the unit vectors (number, 3), spread evenly over the sphere."""
    k = torch.arange(number, dtype=torch.float64) + 0.5
    z, angle = 1.0 - 2.0 * k / number, math.pi * (1.0 + math.sqrt(5.0)) * k
    radius = (1.0 - z * z).sqrt()
    return torch.stack([radius * angle.cos(), radius * angle.sin(), z], -1)
