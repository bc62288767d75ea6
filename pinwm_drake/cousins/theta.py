# SPDX-License-Identifier: MIT
"""Random physical parameters of cousins, and the ranges that they are drawn from."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from pinwm_drake.twin.twin import THETA, Estimate, Twin

KEYS = tuple(THETA)
MOMENTS = ("inertia_xx", "inertia_yy", "inertia_zz")
_POSITIVE = ("mass", *MOMENTS)
_SHARES = ("restitution_floor", "restitution_pusher")
_MASS, _AT = KEYS.index("mass"), [KEYS.index(key) for key in MOMENTS]
_TRIES = 64
_ROUNDING = 1e-9  # relative error of the triangle inequality that the physics allows


@dataclass(frozen=True)
class Range:
    """Range from which a parameter is drawn, evenly, in its unit.

    The source of its ends is "delta" for (1 - delta) to (1 + delta) times the twin's value. It is "interval" for the
    identified interval, and "interval to delta" or "delta to interval" where the ends differ in it.
    """

    low: float
    high: float
    source: str


def theta_ranges(theta: Mapping[str, Estimate], delta: float, *, from_intervals: bool) -> dict[str, Range]:
    """Range of each parameter in the order of `THETA`, cut to values that a body can have.

    Args:
        theta: Estimates of the twin's parameters, by name.
        delta: Relative half-width, 0 or more, less than 1.
        from_intervals: Flag: the identified 95 % intervals are the ranges. An interval that was not computed, and an
            end that is infinite or (of mass and inertia) not above 0, is replaced by that of delta; `source` says so.
    """
    return {key: _range(key, theta[key], delta, from_intervals) for key in THETA}


def _range(key: str, estimate: Estimate, delta: float, from_intervals: bool) -> Range:
    low, high = sorted((estimate.value * (1.0 - delta), estimate.value * (1.0 + delta)))
    sources = ["delta", "delta"]
    if from_intervals and estimate.interval is not None:
        below, above = estimate.interval
        known = math.isfinite(below) and (below > 0.0 or key not in _POSITIVE), math.isfinite(above)
        ends = (below if known[0] else low, above if known[1] else high)
        if ends[0] <= ends[1]:
            low, high = ends
            sources = ["interval" if one else "delta" for one in known]
    return Range(_allowed(key, low), _allowed(key, high), " to ".join(dict.fromkeys(sources)))


def _allowed(key: str, end: float) -> float:
    """End of a range, moved into the range of coefficients: 0 or more, restitutions 1 or less."""
    if key in _POSITIVE:
        return end
    return min(max(end, 0.0), 1.0) if key in _SHARES else max(end, 0.0)


def draw_theta(generator: np.random.Generator, twin: np.ndarray, ranges: Mapping[str, Range]) -> np.ndarray:
    """Parameters, each drawn evenly from its range, of a body that can be.

    Moments of inertia are drawn together until no two of them are less than the third. For a body so thin that none of
    64 draws has this, the last one is taken and moved back towards the twin's, as far as needed.

    Where both mass and inertia come from identified intervals, the moments are for the twin's mass, and are scaled to
    the drawn one: a video shows their ratio, and the interval of the mass is that of one's guess at it.

    Args:
        generator: Source of randomness; drawn from a fixed number of times.
        twin: (8,) values of the twin, in the order and the units of `THETA`.
        ranges: Ranges of the parameters, by name.

    Returns:
        (8,) values, in the order and the units of `THETA`.
    """
    low, high = (np.array([getattr(ranges[key], end) for key in KEYS]) for end in ("low", "high"))
    theta = _between(low, high, generator.random(len(KEYS)))
    moments = _between(low[_AT], high[_AT], generator.random((_TRIES, len(_AT))))
    theta[_AT] = _of_a_body(twin[_AT], moments)
    if all(ranges[key].source != "delta" for key in ("mass", *MOMENTS)):
        theta[_AT] *= theta[_MASS] / twin[_MASS]
    return theta


def drawn_theta(twin: Twin, theta: Mapping[str, float], drawn: Mapping[str, float]) -> dict[str, float]:
    """Values of `THETA` by one draw from a twin's posterior where its intervals tell that they were identified.

    Others stay as they are. Moments of inertia are drawn for the twin's mass, and are scaled to that of the result: a
    video shows their ratio.
    """
    known = {key: drawn[key] for key, one in twin.theta.items() if one.interval is not None and key in drawn}
    found = dict(theta) | known
    if any(key in known for key in MOMENTS):
        scale = found["mass"] / drawn["mass"]
        found |= {key: drawn[key] * scale for key in MOMENTS}
    return found


def _between(low: np.ndarray, high: np.ndarray, share: np.ndarray) -> np.ndarray:
    return np.minimum(low + (high - low) * share, high)


def _of_a_body(twin: np.ndarray, moments: np.ndarray) -> np.ndarray:
    """First of the moments (n, 3) kg m^2 that a body can have, else the last, moved towards the twin's (3,)."""
    fits = (_excess(moments) >= -_ROUNDING * moments).all(axis=1)
    if fits.any():
        return np.asarray(moments[int(fits.argmax())])
    last, room = moments[-1], np.maximum(_excess(twin), 0.0)
    missing = np.minimum(_excess(last), 0.0)
    share = np.where(missing < 0.0, room / np.where(missing < 0.0, room - missing, 1.0), 1.0).min()
    return np.asarray(twin + share * (last - twin))


def _excess(moments: np.ndarray) -> np.ndarray:
    """Excess of the other two moments of (..., 3) over each: twice the second moments of mass."""
    return np.asarray(moments.sum(axis=-1, keepdims=True) - 2.0 * moments)
