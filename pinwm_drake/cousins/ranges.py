"""Ranges from which the physical parameters of a cousin are drawn."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from pinwm_drake.twin.twin import THETA, Estimate

Source = Literal["delta", "interval", "interval to delta", "delta to interval"]

MOMENTS = ("inertia_xx", "inertia_yy", "inertia_zz")
_POSITIVE = ("mass", *MOMENTS)
_SHARES = ("restitution_floor", "restitution_pusher")


@dataclass(frozen=True)
class Range:
    """Range from which a parameter is drawn, evenly.

    Attributes:
        low, high: Ends of the range, in the parameter's unit.
        source: Origin of the ends: "delta" for (1 - delta) to (1 + delta) times the twin's value, "interval" for the
            identified interval; "interval to delta" and "delta to interval" where low and high end differ in it.
    """

    low: float
    high: float
    source: Source


def theta_ranges(theta: Mapping[str, Estimate], delta: float, *, from_intervals: bool) -> dict[str, Range]:
    """Range of each parameter, cut to values that a body can have.

    Args:
        theta: Estimates of the twin's parameters, by name.
        delta: Relative half-width, 0 or more, less than 1.
        from_intervals: Flag: the identified 95 % intervals are the ranges. An interval that was not computed, and an
            end that is infinite or (of mass and inertia) not above 0, is replaced by that of delta; `source` says so.

    Returns:
        A range for each key of `THETA`, in its order.
    """
    return {key: _range(key, theta[key], delta, from_intervals) for key in THETA}


def _range(key: str, estimate: Estimate, delta: float, from_intervals: bool) -> Range:
    value = estimate.value
    low, high = sorted((value * (1.0 - delta), value * (1.0 + delta)))
    source: Source = "delta"
    if from_intervals and estimate.interval is not None:
        below, above = estimate.interval
        known = math.isfinite(below) and (below > 0.0 or key not in _POSITIVE), math.isfinite(above)
        ends = (below if known[0] else low, above if known[1] else high)
        if any(known) and ends[0] <= ends[1]:
            low, high = ends
            source = _SOURCES[known]
    return Range(_allowed(key, low), _allowed(key, high), source)


_SOURCES: dict[tuple[bool, bool], Source] = {
    (True, True): "interval",
    (True, False): "interval to delta",
    (False, True): "delta to interval",
}


def _allowed(key: str, end: float) -> float:
    """End of a range, moved into the range of coefficients: 0 or more, restitutions 1 or less."""
    if key in _POSITIVE:
        return end
    return min(max(end, 0.0), 1.0) if key in _SHARES else max(end, 0.0)
