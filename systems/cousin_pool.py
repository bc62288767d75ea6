"""Cousins for the episodes of a training: drawn beforehand, as drawing colours takes longer than some actions."""

import numpy as np

from pinwm_drake.cousins import Cousin, CousinDraw
from pinwm_drake.errors import ParameterError


class CousinPool:
    """Gives each episode one of a number of cousins; a round of the training has cousins of its own.

    Meant as `PushWorlds.on_reset`.

    Attributes:
        draw: Where the cousins come from.
        size: How many there are in a round.
    """

    def __init__(self, draw: CousinDraw, size: int = 64) -> None:
        """Draws the first round's.

        Args:
            draw: Of the twin.
            size: 1 or more.

        Raises:
            ParameterError: The size is out of range.
        """
        if size < 1:
            raise ParameterError(f"size: got {size}; allowed: 1 or more")
        self.draw, self.size = draw, size
        self.begin(0)

    def begin(self, seed: int) -> None:
        """Draws other cousins, which follow from a seed."""
        self._random = np.random.default_rng(seed)
        numbers = self._random.integers(1 << 31, size=self.size)
        self._members = [self.draw.cousin(int(number)) for number in numbers]

    def __call__(self, world: int) -> Cousin:
        """The cousin that a world becomes."""
        return self._members[int(self._random.integers(self.size))]
