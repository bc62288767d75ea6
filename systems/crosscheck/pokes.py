# SPDX-License-Identifier: MIT
"""Comparison of the learned twin with Drake's own contact models, by fast pokes that tip an object.

After a push the question is where the object lies; after a poke it is on which face, which a small difference can
decide. So engines are compared at the moment the pusher stops, and by the face on which the object comes to rest: one
that only few engines come to is wrong as far as anyone can tell.
"""

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pydrake.common.eigen_geometry import Quaternion
from pydrake.math import RotationMatrix
from rich.table import Table

from pinwm_drake.capture.pusher import upright_shape
from pinwm_drake.errors import ParameterError
from pinwm_drake.systems.crosscheck.alike import TWIN, Effect, alike, effects, like
from pinwm_drake.systems.crosscheck.difference import angles_between
from pinwm_drake.systems.crosscheck.motion import Cases, Motion, SceneRig
from pinwm_drake.systems.crosscheck.options import CrossCheckOptions
from pinwm_drake.systems.crosscheck.trials import Trial, draw_object
from pinwm_drake.systems.pusher.choice import choose_poke
from pinwm_drake.systems.scenario.setup import Setup

_TIPS = math.radians(10.0)  # of a poke that counts, in the twin
_OTHER = math.radians(45.0)  # between the ups of two faces
_ATTEMPTS = 60  # for each poke
# What the twin may differ by at the pusher's stop, in the median, and the share of pokes that may end on another face.
_TRANSLATION, _ROTATION, _SHARE = 14e-3, 0.15, 0.1


@dataclass(frozen=True)
class PokeVerdict:
    """Verdict on one engine, the twin or another.

    Attributes:
        engine: Name of the engine.
        failed: Number of pokes in which it gave up.
        other_face: Number of pokes after which the object lies on another face than in the majority of engines.
        translation: (2,) m, of O from the twin's at the pusher's stop: median, and nine of ten.
        rotation: (2,) rad, likewise.
    """

    engine: str
    failed: int
    other_face: int
    translation: tuple[float, float]
    rotation: tuple[float, float]


@dataclass(frozen=True, eq=False)
class PokeCheck:
    """Results of a cross-check by pokes: motions by the engine's name, and a verdict on each, the twin's first."""

    trials: list[Trial]
    motions: list[dict[str, Motion]]
    verdicts: list[PokeVerdict]
    effects: list[Effect] = dataclasses.field(default_factory=list)  # of parameters that plants do not take over

    @property
    def passed(self) -> bool:
        """Flag: the twin ends on the majority's faces, and is near each engine at the pusher's stop."""
        twin, *others = self.verdicts
        near = all(one.translation[0] <= _TRANSLATION and one.rotation[0] <= _ROTATION for one in others)
        return near and twin.other_face + twin.failed <= _SHARE * len(self.trials)

    def table(self) -> Table | None:
        """Table of the differences: None, as the lines of `words` tell all."""
        return None

    def results(self) -> list[tuple[bool, str]]:
        """Verdict on the twin."""
        return [(self.passed, "twin")]

    def write(self, out: str | Path, setup: Setup, title: str) -> list[Path]:
        """Files of the check: there are none."""
        return []

    def words(self) -> list[str]:
        """Lines: one for each parameter that a plant does not take over, and one for each engine."""
        lines = [effect.words() for effect in self.effects]
        for one in self.verdicts:
            line = f"{one.engine}: another face than the majority after {one.other_face} of {len(self.trials)} pokes"
            if one.engine != "twin":
                line += (
                    f"; from the twin at the pusher's stop {1e3 * one.translation[0]:.1f} mm, {one.rotation[0]:.2f} rad"
                    f" (nine of ten {1e3 * one.translation[1]:.1f} mm, {one.rotation[1]:.2f} rad)"
                )
            lines.append(line + (f"; gave up in {one.failed}" if one.failed else ""))
        return lines


def draw_pokes(setup: Setup, number: int, seed: int) -> list[Trial]:
    """Draws pokes that tip the object in the twin, upwards, at 0.6 to 1 m/s, at a side; arguments as for `draw_trials`.

    Poke k does not depend on their number.

    Raises:
        InputError: A mesh cannot be used.
        ParameterError: The pusher meets no side of the object, or no poke tips it.
    """
    rig, twin, trials = SceneRig(setup, "twin"), setup.twin, []
    shape = upright_shape(twin.pusher)
    for k in range(number):
        generator = np.random.default_rng([seed, k])
        for _ in range(_ATTEMPTS):
            X_WO, mesh_W, p_WB = draw_object(setup, None, generator)
            poke = choose_poke(mesh_W, p_WB, shape, generator, floor_height=twin.floor_height)
            trial = Trial(X_WO, poke)
            if _tilt(rig.run(trial)) > _TIPS:
                break
        else:
            raise ParameterError(
                f"{setup.scenario.name}: none of {_ATTEMPTS} pokes tips the object; a lighter or slimmer object tips"
            )
        trials.append(trial)
    return trials


def judge_pokes(
    options: CrossCheckOptions, cases: Cases, trials: Sequence[Trial], motions: Sequence[dict[str, Motion]]
) -> PokeCheck:
    """Compare the motions of an object that is poked in the twin and in plants; arguments as for `run_trials`."""
    found = effects(cases[TWIN], options.engines, motions)
    return PokeCheck(list(trials), list(motions), judge(motions, options.engines), found)


def judge(motions: Sequence[dict[str, Motion]], engines: Sequence[str]) -> list[PokeVerdict]:
    """Verdicts on the engines of pokes, those of the twin first.

    Where a plant does not take over all of the twin, the twin without the rest is what it is compared with.
    """
    verdicts, unlike = [], [like(engine) for engine in engines if like(engine) in motions[0]]
    voters = [*(unlike or [TWIN])[:1], *engines]
    for engine, mine in zip((TWIN, *engines), voters, strict=True):
        twin = alike(engine, motions[0])
        done = [one for one in motions if not one[engine].failure and not one[twin].failure]
        pairs = [(one[twin], one[engine]) for one in done]
        ways = np.array([np.linalg.norm(a.p_WO[a.stop] - b.p_WO[b.stop]) for a, b in pairs])
        turns = np.array([float(angles_between(a.q_WO[a.stop], b.q_WO[b.stop])) for a, b in pairs])
        verdicts.append(
            PokeVerdict(
                engine,
                failed=sum(bool(one[engine].failure) for one in motions),
                other_face=sum(_is_other({name: one[name] for name in voters}, mine) for one in motions),
                translation=_median_and_most(ways),
                rotation=_median_and_most(turns),
            )
        )
    return verdicts


def _tilt(motion: Motion) -> float:
    """Largest angle [rad] by which the object's up leaves that of the start; 0 after a failure."""
    if motion.failure:
        return 0.0
    ups = np.array([_up(q) for q in motion.q_WO])
    return float(np.arccos(np.clip(ups @ ups[0], -1.0, 1.0)).max())


def _up(q_WO: np.ndarray) -> np.ndarray:
    """Return the world's z (3,) in the object's axes."""
    return np.asarray(RotationMatrix(Quaternion(wxyz=q_WO / np.linalg.norm(q_WO))).matrix()[2])


def _is_other(motions: dict[str, Motion], engine: str) -> bool:
    ups = {name: _up(motion.q_WO[-1]) for name, motion in motions.items() if not motion.failure}
    if engine not in ups:
        return False
    alike = {a: sum(bool(ups[a] @ up > math.cos(_OTHER)) for up in ups.values()) for a in ups}
    most = max(alike, key=lambda name: alike[name])
    return alike[most] > len(ups) / 2 and bool(ups[engine] @ ups[most] <= math.cos(_OTHER))


def _median_and_most(values: np.ndarray) -> tuple[float, float]:
    if not len(values):
        return math.inf, math.inf
    return float(np.median(values)), float(np.quantile(values, 0.9))
