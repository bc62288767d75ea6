"""Words for estimates: values and intervals to the digits that they have, and errors."""

import math

from pinwm_drake.twin.twin import Estimate


def interval_words(estimate: Estimate) -> tuple[str, str]:
    """Value and interval in words, both to the digits that the interval leaves."""
    if estimate.interval is None:
        return f"{estimate.value:.4g}", "–"
    low, high = estimate.interval
    digits = 4
    if 0.0 < high - low < math.inf and estimate.value != 0.0:
        digits = min(max(1 + math.ceil(math.log10(abs(estimate.value) / (high - low))), 3), 8)
    return _rounded(estimate.value, digits), f"{_rounded(low, digits)} to {_rounded(high, digits)}"


def _rounded(value: float, digits: int) -> str:
    if math.isinf(value):
        return "∞" if value > 0 else "−∞"
    return f"{value:#.{digits}g}".rstrip(".") if value else "0"


def error_words(estimate: Estimate, truth: float | None) -> tuple[str, str]:
    """The true value, and the error of an estimate in per cent of it."""
    if truth is None:
        return "–", "–"
    error = f"{100 * (estimate.value - truth) / abs(truth):+.1f} %" if truth else f"{estimate.value - truth:+.3g}"
    return f"{truth:.4g}", error
