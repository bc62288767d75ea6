"""Estimates in `twin.yaml`: numbers with interval, flag, unit and note."""

import math
from collections.abc import Mapping
from typing import Any

from pinwm_drake.documents import Entry
from pinwm_drake.twin.twin import THETA, Estimate

_KEYS = ("value", "interval", "identifiable", "unit", "note")
_INERTIA = ("inertia_xx", "inertia_yy", "inertia_zz")
_ROUNDING = 1e-9  # relative, of the triangle inequality: what the physics allows


def estimate_to_document(estimate: Estimate) -> dict[str, Any]:
    """Plain data of an estimate; .inf stays in an interval, where it has a meaning."""
    low_high = estimate.interval
    return {
        "value": float(estimate.value),
        "interval": None if low_high is None else [float(end) for end in low_high],
        "identifiable": bool(estimate.identifiable),
        "unit": estimate.unit,
        "note": estimate.note,
    }


def read_theta(entry: Entry) -> dict[str, Estimate]:
    """The physical parameters, in the order of `THETA`.

    Raises:
        InputError: A key is missing or unknown, an estimate is wrong, or a value is none that a body can have.
    """
    entry.only(*THETA)
    theta = {key: _read_estimate(entry[key], unit) for key, unit in THETA.items()}
    for key in ("mass", *_INERTIA):
        if theta[key].value <= 0.0:
            raise entry[key]["value"].refusal("above 0")
    for key in ("friction_floor", "friction_pusher"):
        entry[key]["value"].number(0.0)
    for key in ("restitution_floor", "restitution_pusher"):
        entry[key]["value"].number(0.0, 1.0)
    low, middle, high = sorted((theta[key].value, key) for key in _INERTIA)
    if low[0] + middle[0] < high[0] * (1.0 - _ROUNDING):
        raise entry[high[1]]["value"].refusal(f"at most {low[0] + middle[0]:g}, the sum of the other two moments")
    return theta


def read_nuisance(entry: Entry) -> dict[str, Estimate]:
    """Estimates of nuisances, whose keys are free.

    Raises:
        InputError: A key is no text, or an estimate is wrong.
    """
    values: Mapping[object, object] = entry.value if isinstance(entry.value, dict) else {}
    if not isinstance(entry.value, dict) or not all(isinstance(key, str) and key for key in values):
        raise entry.refusal("a mapping whose keys are text")
    return {key: _read_estimate(entry[key], None) for key in entry.value}


def _read_estimate(entry: Entry, unit: str | None) -> Estimate:
    """An estimate; `unit` is the one that it has to be in, None for any."""
    entry.only(*_KEYS)
    interval, identifiable = entry["interval"], entry["identifiable"]
    if not isinstance(identifiable.value, bool):
        raise identifiable.refusal("true or false")
    for key in ("unit", "note"):
        if not isinstance(entry[key].value, str):
            raise entry[key].refusal("text, which may be empty")
    if unit is not None and entry["unit"].value != unit:
        raise entry["unit"].refusal(f'"{unit}"')
    ends = None if interval.value is None else _read_interval(interval)
    return Estimate(entry["value"].number(), ends, identifiable.value, entry["unit"].value, entry["note"].value)


def _read_interval(entry: Entry) -> tuple[float, float]:
    """Low and high end of an interval; .inf where the data say nothing on that side."""
    allowed = "null, or two numbers [low, high] with low <= high"
    if not isinstance(entry.value, list) or len(entry.value) != 2:
        raise entry.refusal(allowed)
    low, high = (_read_end(end) for end in entry.items())
    if low > high:
        raise entry.refusal(allowed)
    return low, high


def _read_end(entry: Entry) -> float:
    if isinstance(entry.value, float) and math.isinf(entry.value):
        return entry.value
    return entry.number()
