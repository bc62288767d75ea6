# SPDX-License-Identifier: MIT
"""Like with like: what a plant does not take over of a twin, and the twin without it, to which the plant is compared.

A difference of two engines with unlike parameters says nothing about either. So the twin that a plant is compared with
has only what the plant has too, and what each of the other parameters does is measured in the twin itself.
"""

import dataclasses
import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pinwm_drake.systems.crosscheck.difference import difference_of
from pinwm_drake.systems.crosscheck.motion import Cases, Motion
from pinwm_drake.systems.engines.plant.scene import lying_side
from pinwm_drake.systems.scenario.setup import Setup
from pinwm_drake.systems.sdf.twin import contact_name, not_carried
from pinwm_drake.twin.rollout import NO_EFFECT
from pinwm_drake.twin.twin import Estimate

TWIN = "twin"
CORNERS = "support corners"
"""Name of the weight on an object's corners, of which Drake's plants know nothing."""


@dataclass(frozen=True)
class Effect:
    """Effect of a parameter that a plant does not take over: what the twin moves by without it.

    Attributes:
        engine: Name of the plant.
        name: Name of the parameter.
        value: Its value in the twin.
        neutral: Its value without effect, in the twin that the plant is compared with.
        translation: m, median after rest.
        rotation: rad, median after rest.
    """

    engine: str
    name: str
    value: float | str
    neutral: float | str
    translation: float
    rotation: float

    def words(self) -> str:
        """Return the effect in one line."""
        value, neutral = (v if isinstance(v, str) else f"{v:.4g}" for v in (self.value, self.neutral))
        effect = f"{1e3 * self.translation:.2f} mm and {math.degrees(self.rotation):.2f}°"
        if not math.isfinite(self.translation):
            effect = "unknown, as pushes failed or did not come to rest"
        return (
            f"{self.engine} does not take over {self.name} {value}: compared with the twin at {neutral}; "
            f"its effect in the twin is {effect} in the median"
        )


def missing(setup: Setup, engine: str) -> list[str]:
    """Names of the parameters of a scene's twin that a plant does not take over, and that have an effect."""
    corners = [CORNERS] if setup.twin.support == "corners" else []
    return corners + not_carried(setup.twin, contact_name(engine), lying_side(setup))


def without(setup: Setup, names: Iterable[str]) -> Setup:
    """Return the scene with a twin in which parameters have no effect."""
    twin = setup.twin
    for name in names:
        if name == CORNERS:
            twin = dataclasses.replace(twin, support="patch")
        else:
            estimate = Estimate(NO_EFFECT[name], None, False, twin.nuisance[name].unit, "not in a plant")
            twin = dataclasses.replace(twin, nuisance=twin.nuisance | {name: estimate})
    return dataclasses.replace(setup, twin=twin)


def like(engine: str) -> str:
    """Name of the case of the twin without what a plant does not take over."""
    return f"{TWIN} like {engine}"


def alike(engine: str, cases: Collection[str]) -> str:
    """Name of the case of the twin that a plant is compared with: that of `like` where there is one."""
    return like(engine) if like(engine) in cases else TWIN


def lacking(name: str) -> str:
    """Name of the case of the twin without one parameter."""
    return f"{TWIN} without {name}"


def extra_cases(setup: Setup, engines: Sequence[str]) -> Cases:
    """Cases of the twin beside the twin as it is: as each plant has it, and without each single parameter.

    Args:
        setup: The scene of the twin.
        engines: Names of the plants.

    Returns:
        The cases by `like` and `lacking`; none for a plant that takes over all.
    """
    cases: Cases = {}
    for engine in engines:
        names = missing(setup, engine)
        cases |= {like(engine): without(setup, names)} if names else {}
        cases |= {lacking(name): without(setup, [name]) for name in names}
    return cases


def effects(setup: Setup, engines: Sequence[str], motions: Sequence[Mapping[str, Motion]]) -> list[Effect]:
    """Effects of the parameters that plants do not take over.

    Args:
        setup: The scene of the twin.
        engines: Names of the plants.
        motions: Motions of each push, those of `extra_cases` among them.
    """
    found = []
    for engine in engines:
        for name in missing(setup, engine):
            apart = [difference_of(one[TWIN], one[lacking(name)]) for one in motions]
            value: tuple[float | str, float | str] = ("", "patch")
            if name != CORNERS:
                value = setup.twin.nuisance[name].value, NO_EFFECT[name]
            ways, turns = ([getattr(one, key) for one in apart] for key in ("translation", "rotation"))
            found.append(Effect(engine, name, *value, median(np.array(ways)), median(np.array(turns))))
    return found


def median(values: np.ndarray) -> float:
    """Median of values (n,); infinite rather than undefined where the two in the middle are infinite."""
    with np.errstate(invalid="ignore"):
        middle = float(np.median(values))
    return math.inf if math.isnan(middle) else middle
