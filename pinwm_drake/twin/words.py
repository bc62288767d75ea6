# SPDX-License-Identifier: MIT
"""Estimates in words: in units of a handy size, with the digits that their intervals leave."""

import math
from dataclasses import dataclass

from pinwm_drake.twin.twin import Estimate

IDENTIFIABLE = (
    "identifiable: the videos leave less than half of the spread assumed before, "
    "and less than 30 % of a physical parameter's value"
)
# Factor and name of the unit that is shown for one of a twin.
_HANDY = {
    "1": (1.0, ""),
    "m": (1e3, "mm"),
    "s": (1e3, "ms"),
    "rad": (180.0 / math.pi, "°"),
    "kg m^2": (1e4, "kg cm²"),
}
# Loss above which images are explained badly; pushes of a T-block have 0.001, two rolls of a mug had 0.013 and 0.019.
_UNEXPLAINED = 0.01
_MOST, _USUAL = 5, 3  # significant digits: the most that are shown, and those of a number without an interval


@dataclass(frozen=True)
class EstimateWords:
    """An estimate in words.

    Attributes:
        value: The number.
        interval: Its 95 % interval; "" where there is none.
        unit: Unit of both; "" for a pure number.
    """

    value: str
    interval: str
    unit: str


def handy(unit: str) -> tuple[float, str]:
    """Return the factor to the unit that is shown for one of a twin, and the name of that."""
    return _HANDY.get(unit, (1.0, unit))


def estimate_words(estimate: Estimate) -> EstimateWords:
    """Return an estimate in words; value and interval have as many decimals as leave two digits of the interval."""
    factor, unit = handy(estimate.unit)
    value = factor * estimate.value
    if estimate.interval is None:
        return EstimateWords(f"{value:.{_USUAL}g}", "", unit)
    low, high = (factor * end for end in estimate.interval)
    if 0.0 < high - low < math.inf:
        decimals = 1 - math.floor(math.log10(high - low))
        if value:
            decimals = min(decimals, _MOST - 1 - math.floor(math.log10(abs(value))))
        middle, least, most = (_fixed(one, max(decimals, 0)) for one in (value, low, high))
        if least != most:
            return EstimateWords(middle, f"{least} to {most}", unit)
    return EstimateWords(f"{value:.{_USUAL}g}", f"{_end(low)} to {_end(high)}", unit)


def _fixed(value: float, decimals: int) -> str:
    text = f"{value:.{decimals}f}"
    return text.removeprefix("-") if float(text) == 0.0 else text


def _end(value: float) -> str:
    if math.isinf(value):
        return "∞" if value > 0 else "−∞"
    return f"{value:.{_USUAL}g}"


def doubt_words(loss: float) -> str:
    """Say that images are explained badly, and what to do; "" where they are not."""
    if not loss > _UNEXPLAINED:
        return ""
    return (
        f"the images are explained badly (loss {loss:.4f}; twins that predict well have 0.001 to 0.003): parameters "
        "may be farther off than their intervals say; look where the pictures differ (pinwm report), check mesh, "
        "camera and clock (pinwm capture check), and try another --seed, another push, or half the --time-step"
    )
