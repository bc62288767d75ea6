# SPDX-License-Identifier: MIT
"""Difference of two engines after one and the same push."""

import math
from dataclasses import dataclass

import numpy as np

from pinwm_drake.systems.crosscheck.motion import MODES, SEPARATED, Motion

# Share of the most kinetic energy by which energy may rise where nothing drives the object. Measured: 1e-6 at most.
ENERGY_TOLERANCE = 1e-3


@dataclass(frozen=True)
class Course:
    """Summary of one motion by itself.

    Attributes:
        moved: m, translation of the object's origin O from start to end.
        turned: rad, rotation of the object from start to end.
        rest_time: s, when the object came to rest; infinite where it did not.
        floor: Shares (3,) of the time from the first contact of the pusher to rest in which object and floor are
            separated, sticking and sliding.
        pusher: Shares (3,) of that time in which object and pusher are.
        energy_stop: J, kinetic energy of the object when the pusher stopped, which friction had to take.
        energy_peak: J, largest kinetic energy.
        energy_rise: J, rise of kinetic energy and weight times height together, after the pusher had stopped.
        failure: Error of the engine when it gave up; empty where it did not.
    """

    moved: float
    turned: float
    rest_time: float
    floor: tuple[float, ...]
    pusher: tuple[float, ...]
    energy_stop: float
    energy_peak: float
    energy_rise: float
    failure: str

    @property
    def energy_rises(self) -> bool:
        """Flag: energy came from nowhere, by more than `ENERGY_TOLERANCE`."""
        return self.energy_rise > ENERGY_TOLERANCE * self.energy_peak

    @property
    def sound(self) -> bool:
        """Flag: the engine came to an end, with the object at rest."""
        return not self.failure and math.isfinite(self.rest_time)

    def words(self) -> str:
        """Remarks on a failure, a motion without rest, or a rise of energy; empty where there is none."""
        if self.failure:
            return self.failure
        parts = [] if math.isfinite(self.rest_time) else ["does not come to rest"]
        return ", ".join([*parts, *(["energy rises"] if self.energy_rises else [])])


@dataclass(frozen=True)
class Difference:
    """Difference of the object's poses in two engines; infinite where one of them failed or did not come to rest.

    Attributes:
        translation: m, distance of the two origins O after rest.
        rotation: rad, angle between the two orientations after rest.
        path_translation: m, largest distance at one time.
        path_rotation: rad, largest angle at one time.
        same_modes: Share of the time in which both pairs touch in the same mode in both engines.
    """

    translation: float
    rotation: float
    path_translation: float
    path_rotation: float
    same_modes: float


def course_of(motion: Motion, weight: float) -> Course:
    """Summary of a motion.

    Args:
        motion: Motion in one engine.
        weight: N, weight of the object.
    """
    touched = np.flatnonzero(motion.pusher != SEPARATED)
    first = int(touched[0]) if len(touched) else 0
    last = max(motion.rest if motion.rest is not None else len(motion.t), first + 1)
    floor, pusher = (
        tuple(float((modes[first:last] == mode).mean()) for mode in range(len(MODES)))
        for modes in (motion.floor, motion.pusher)
    )
    energy = (motion.kinetic + weight * motion.height)[motion.stop :]
    rise = energy - np.minimum.accumulate(energy)
    return Course(
        moved=float(np.linalg.norm(motion.p_WO[-1] - motion.p_WO[0])),
        turned=float(angles_between(motion.q_WO[-1], motion.q_WO[0])),
        rest_time=math.inf if motion.rest is None else float(motion.t[motion.rest]),
        floor=floor,
        pusher=pusher,
        energy_stop=float(motion.kinetic[motion.stop]),
        energy_peak=float(motion.kinetic.max()),
        energy_rise=float(rise.max()),
        failure=motion.failure,
    )


def difference_of(one: Motion, other: Motion) -> Difference:
    """Compare two motions of the same push; the one that ends first stays where it is."""
    if any(motion.failure or motion.rest is None for motion in (one, other)):
        return Difference(*4 * (math.inf,), 0.0)
    n = max(len(one.t), len(other.t))
    p, other_p = (_held(motion.p_WO, n) for motion in (one, other))
    q, other_q = (_held(motion.q_WO, n) for motion in (one, other))
    ways, angles = np.linalg.norm(p - other_p, axis=1), angles_between(q, other_q)
    same = np.ones(n, bool)
    for name in ("floor", "pusher"):
        same &= _held(getattr(one, name), n) == _held(getattr(other, name), n)
    touched = np.flatnonzero((_held(one.pusher, n) != SEPARATED) | (_held(other.pusher, n) != SEPARATED))
    first = int(touched[0]) if len(touched) else 0
    last = max(one.rest or 0, other.rest or 0, first + 1)
    return Difference(
        translation=float(ways[-1]),
        rotation=float(angles[-1]),
        path_translation=float(ways.max()),
        path_rotation=float(angles.max()),
        same_modes=float(same[first:last].mean()),
    )


def _held(values: np.ndarray, n: int) -> np.ndarray:
    """Values (m, ...) with the last row repeated up to n rows."""
    return np.concatenate([values, np.repeat(values[-1:], n - len(values), axis=0)])


def angles_between(q: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Angles (...) rad between orientations (..., 4) wxyz."""
    # The nearer one of q and -q; the chord is exact for small angles, where an arc cosine is not.
    chord = np.minimum(np.linalg.norm(q - other, axis=-1), np.linalg.norm(q + other, axis=-1))
    return np.asarray(4.0 * np.arcsin(np.minimum(0.5 * chord, 1.0)))
