# SPDX-License-Identifier: MIT
"""Cross-entropy method: minimum of a function that has no gradient, in the unit cube.

Source: Rubinstein, "The cross-entropy method for combinatorial and continuous optimization", 1999: Gaussians with a
variance for each coordinate. Deviations: the first round is even over the cube, so that no guess is needed, and elites
stay until better points are found, so that a search never moves away from what it has.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from pinwm_drake.errors import require


@dataclass(frozen=True)
class CrossEntropyBudget:
    """Budget of a search.

    Attributes:
        elites: Number of the best points so far, to which the next round's Gaussian is fitted.
    """

    samples: int = 20
    elites: int = 4
    rounds: int = 10

    def __post_init__(self) -> None:
        require("samples", self.samples, 2 <= self.samples <= 1_000_000, "2 to 1000000")
        require("elites", self.elites, 2 <= self.elites <= self.samples, f"2 to {self.samples}, the samples")
        require("rounds", self.rounds, 1 <= self.rounds <= 100_000, "1 to 100000")


# Ten times the samples and twice the rounds: a search that is not short of simulations.
GENEROUS = CrossEntropyBudget(samples=200, elites=20, rounds=20)


@dataclass(frozen=True, eq=False)
class Minimum:
    """Least value that a search came across.

    Attributes:
        point: (d,), where it was found, in the unit cube.
        rounds: (rounds,), the least value of each round.
    """

    point: np.ndarray
    value: float
    rounds: np.ndarray


def minimise(
    function: Callable[[np.ndarray], np.ndarray],
    number: int,
    budget: CrossEntropyBudget,
    generator: np.random.Generator,
) -> Minimum:
    """Search the unit cube.

    Args:
        function: Values (samples,) of points (samples, number); infinite where there is none.
        number: Number of coordinates.
        budget: Points and rounds.
        generator: Source of randomness.

    Returns:
        The best of all points that were tried.
    """
    points = generator.random((budget.samples, number))
    elites, least, rounds = points[:0], np.empty(0), []
    for _ in range(budget.rounds):
        values = function(points)
        rounds.append(values.min())
        points, values = np.concatenate([elites, points]), np.concatenate([least, values])
        order = np.argsort(values, kind="stable")[: budget.elites]
        elites, least = points[order], values[order]
        noise = generator.normal(size=(budget.samples, number))
        points = np.clip(elites.mean(0) + elites.std(0) * noise, 0.0, 1.0)
    return Minimum(elites[0], float(least[0]), np.array(rounds))
