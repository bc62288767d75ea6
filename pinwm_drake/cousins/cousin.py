# SPDX-License-Identifier: MIT
"""Cousins of a twin: the draws that make them, and the cousin that belongs to a number.

Source: PIN-WM, eq. 11: physical parameters and colours from U(w (1 - delta), w (1 + delta)). Here the draws are cut to
what can be: see `theta.py` and `colours.py`.
"""

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass, field, fields
from functools import cached_property

import numpy as np
import torch
from torch import Tensor

from pinwm_drake.cousins.colours import ColourDraw
from pinwm_drake.cousins.theta import KEYS, draw_theta, drawn_theta, theta_ranges
from pinwm_drake.errors import ParameterError
from pinwm_drake.physics.parameters import Parameters
from pinwm_drake.scene import Scene
from pinwm_drake.twin.rollout import NO_EFFECT, twin_parameters, twin_scene
from pinwm_drake.twin.twin import Estimate, Twin

_MOST = 1 << 31  # cousins, and their numbers
_NOTE = "of a cousin"


@dataclass(frozen=True, eq=False)
class Cousin:
    """A copy of a twin with other parameters and colours.

    Attributes:
        of: The twin.
        number: Number of the cousin, 0 or more; with seed and settings of the draw it tells the cousin.
        theta: Values of `THETA`'s parameters, SI units.
        shape: Values of the nuisances that have a part in the physics (`rollout.NO_EFFECT`), SI units.
        looks: Gives `sh` and `moved`; called once, when one of them is asked for.
    """

    of: Twin
    number: int
    theta: dict[str, float]
    shape: dict[str, float]
    looks: Callable[[], tuple[Tensor, float]]
    _known: list[tuple[Scene, Parameters]] = field(default_factory=list, init=False, repr=False)

    @cached_property
    def _looks(self) -> tuple[Tensor, float]:
        return self.looks()

    @property
    def sh(self) -> Tensor:
        """Harmonics (N, K, 3) float32 of the surfels."""
        return self._looks[0]

    @property
    def moved(self) -> float:
        """Share of the colours (surfels times channels) that had to be moved back to be displayable."""
        return self._looks[1]

    def twin(self) -> Twin:
        """Return the cousin as a twin of its own, for everything that takes one."""
        surfels = dataclasses.replace(self.of.surfels, sh=self.sh)
        return dataclasses.replace(self._physical(), surfels=surfels)

    def parameters(self, scene: Scene) -> Parameters:
        """Parameters theta of the cousin, one world of the twin's scene in any orientation; the last are kept."""
        if not self._known or self._known[0][0] is not scene:
            self._known[:] = [(scene, twin_parameters(self._physical(), scene))]
        return self._known[0][1]

    def _physical(self) -> Twin:
        theta = {key: Estimate(self.theta[key], None, False, one.unit, _NOTE) for key, one in self.of.theta.items()}
        units = {key: "m" if key.startswith(("center", "contact")) else "1" for key in self.shape}
        shape = {key: Estimate(value, None, False, units[key], _NOTE) for key, value in self.shape.items()}
        return dataclasses.replace(self.of, theta=theta, nuisance=self.of.nuisance | shape, draws=None)


class CousinDraw:
    """Draw of cousins by number; a cousin follows from seed and number, whatever was drawn before.

    Attributes:
        twin, delta, from_intervals, seed: Arguments of the draw.
        ranges: Ranges of the parameters theta, by name; each says whether it comes from delta or from an identified
            interval.
    """

    def __init__(self, twin: Twin, *, delta: float = 0.1, from_intervals: bool = False, seed: int = 0) -> None:
        """Prepare the ranges and the colours of the twin.

        Args:
            twin: The twin.
            delta: Relative half-width of the ranges, 0 or more, less than 1.
            from_intervals: Flag: what was identified is drawn from the posterior of the twin, all of it together; from
                the identified 95 % intervals where a twin has no draws.
            seed: Seed of the draw, 0 or more.

        Raises:
            ParameterError: delta or seed is out of range.
        """
        if isinstance(delta, bool) or not (math.isfinite(delta) and 0.0 <= delta < 1.0):
            raise ParameterError(f"delta: got {delta}; allowed: 0 or more, less than 1")
        self.twin, self.delta, self.from_intervals = twin, float(delta), from_intervals
        self.seed = _whole("seed", seed, 0, None)
        self.ranges = theta_ranges(twin.theta, self.delta, from_intervals=from_intervals)
        self._values = np.array([twin.theta[key].value for key in KEYS])
        self._colours = ColourDraw(twin.surfels)

    def cousin(self, number: int) -> Cousin:
        """Cousin of a number, 0 or more. Its colours are drawn when they are asked for, which takes a few ms.

        Raises:
            ParameterError: The number is out of range.
        """
        number = _whole("number", number, 0, _MOST)
        # A generator each, so that neither depends on how much the other draws.
        physics, looks = (
            np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=(number, part))) for part in (0, 1)
        )
        theta = dict(zip(KEYS, draw_theta(physics, self._values, self.ranges).tolist(), strict=True))
        shape = twin_shape(self.twin)
        if self.from_intervals and self.twin.draws is not None:
            row = int(physics.integers(len(self.twin.draws.values)))
            drawn = dict(zip(self.twin.draws.names, self.twin.draws.values[row].tolist(), strict=True))
            theta = drawn_theta(self.twin, theta, drawn)
            shape |= {key: value for key, value in drawn.items() if key in shape}
        return Cousin(self.twin, number, theta, shape, lambda: self._colours.draw(looks, self.delta))


def twin_shape(twin: Twin) -> dict[str, float]:
    """Values of the nuisances of a twin that have a part in its physics, by name."""
    return {key: twin.nuisance[key].value if key in twin.nuisance else value for key, value in NO_EFFECT.items()}


@dataclass(frozen=True, eq=False)
class Cousins:
    """Cousins 0 to n - 1 of a twin, and the draw that gives further ones."""

    draw: CousinDraw
    members: tuple[Cousin, ...]

    def __len__(self) -> int:
        return len(self.members)

    def __getitem__(self, number: int) -> Cousin:
        return self.members[number]

    def parameters(self, scene: Scene | None = None) -> Parameters:
        """Parameters theta of n worlds, one for each cousin.

        Args:
            scene: The twin's scene, of any orientation; None makes one, which takes longer.

        Raises:
            InputError: A mesh cannot be used.
        """
        if scene is None:
            scene = twin_scene(self.draw.twin, torch.tensor([1.0, 0.0, 0.0, 0.0], dtype=torch.float64))
        each = [cousin.parameters(scene) for cousin in self.members]
        return Parameters(*(torch.cat([getattr(one, item.name) for one in each]) for item in fields(Parameters)))

    def sh(self) -> Tensor:
        """Harmonics (n, N, K, 3) float32 of the surfels."""
        return torch.stack([cousin.sh for cousin in self.members])


def draw_cousins(twin: Twin, n: int, delta: float = 0.1, *, seed: int = 0, from_intervals: bool = False) -> Cousins:
    """Draws cousins of a twin; the first of them are the same for every n.

    Args:
        twin: The twin.
        n: Number of cousins, 1 or more.
        delta: Relative half-width of the ranges, 0 or more, less than 1; with 0, all are the twin.
        seed: Seed of the draw, 0 or more.
        from_intervals: Flag: what was identified is drawn from the twin's posterior; see `CousinDraw`.

    Raises:
        ParameterError: n, delta or seed is out of range.
    """
    n = _whole("n", n, 1, _MOST)
    draw = CousinDraw(twin, delta=delta, from_intervals=from_intervals, seed=seed)
    return Cousins(draw, tuple(draw.cousin(number) for number in range(n)))


def _whole(name: str, value: int, low: int, high: int | None) -> int:
    whole = isinstance(value, (int, np.integer)) and not isinstance(value, bool)
    if not whole or value < low or (high is not None and value > high):
        allowed = f"a whole number, {low} or more" if high is None else f"a whole number from {low} to {high}"
        raise ParameterError(f"{name}: got {value!r}; allowed: {allowed}")
    return int(value)
