"""Settings of ASID's identification."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from pinwm_drake.errors import require
from pinwm_drake.identification.pose_tracker import PoseTrackerOptions
from pinwm_drake.paper.baselines.asid.cross_entropy import CrossEntropyBudget

Span = tuple[float, float]
_FRICTIONS = ("friction_floor", "friction_pusher")
_RESTITUTIONS = ("restitution_floor", "restitution_pusher")


@dataclass(frozen=True)
class AsidOptions:
    """Settings of a search for theta by simulated poses.

    Attributes:
        budget: Simulations that the search may use.
        friction: Range of both coefficients of friction. Objects that are flipped rather than pushed grip more, 0.05
            to 1.
        restitution: Range of both coefficients of restitution.
        inertia: Range of the factor of all moments of inertia, against a uniform solid of the same mass.
        mass: Range of the mass, kg, where it is looked for.
        free: Names of what is looked for; None for everything but a mass that the capture tells.
        held: Values of what is not looked for, by name; with the inertia held, the mass has an effect.
        tracker: Settings of the pose tracker.
        time_step: Time step of the physics, s.
        num_threads: Threads of the physics; None for one on each core.
    """

    budget: CrossEntropyBudget = field(default_factory=CrossEntropyBudget)
    friction: Span = (0.005, 0.5)
    restitution: Span = (0.0, 0.5)
    inertia: Span = (0.3, 3.0)
    mass: Span = (0.2, 5.0)
    free: tuple[str, ...] | None = None
    held: Mapping[str, float] = field(default_factory=dict)
    tracker: PoseTrackerOptions = field(default_factory=PoseTrackerOptions)
    time_step: float = 1.0 / 240.0
    num_threads: int | None = None

    def __post_init__(self) -> None:
        most = {"friction": 5.0, "restitution": 1.0, "inertia": 20.0, "mass": 1e3}
        for name, end in most.items():
            low, high = getattr(self, name)
            least = 0.0 if name == "restitution" else 1e-4
            allowed = f"two numbers of {least:g} to {end:g}, the first below the second"
            require(name, (low, high), least <= low < high <= end, allowed)
        require("time_step", self.time_step, 1e-5 <= self.time_step <= 0.05, "1e-5 to 0.05 s")
        names = {*_FRICTIONS, *_RESTITUTIONS, "inertia", "mass"}
        chosen = set(self.free or names)
        require("free", self.free, chosen <= names, ", ".join(sorted(names)))
        if self.free is not None:
            held = names - chosen - {"mass"}
            require("held", sorted(self.held), held <= set(self.held) <= names - chosen, f"{', '.join(sorted(held))}")
        number = self.num_threads
        require("num_threads", number, number is None or number >= 1, "1 or more, or none")

    def ranges(self, *, mass_known: bool) -> dict[str, Span]:
        """Ranges of the unknowns, by the names of `THETA`; "inertia" is the factor of all three moments."""
        found = dict.fromkeys(_FRICTIONS, self.friction) | dict.fromkeys(_RESTITUTIONS, self.restitution)
        found |= {"inertia": self.inertia, "mass": self.mass}
        names = self.free or [name for name in found if name != "mass" or not mass_known]
        return {name: found[name] for name in names}


def physical(points: np.ndarray, ranges: Mapping[str, Span]) -> dict[str, np.ndarray]:
    """Physical values (W,) of points (W, d) of the unit cube, by name; what is positive counts by its logarithm.

    Args:
        points: A column for each of `ranges`, in their order.
        ranges: Low and high ends, by name.
    """
    values = {}
    for share, (name, (low, high)) in zip(points.T, ranges.items(), strict=True):
        values[name] = low * (high / low) ** share if low > 0.0 else low + (high - low) * share
    return values
