"""Tables of estimates for a page."""

import math
from collections.abc import Mapping

from pinwm_drake.report.page import table, text
from pinwm_drake.twin.twin import Estimate

_NUMBER = "number"


def estimates_table(estimates: Mapping[str, Estimate], truth: Mapping[str, float]) -> str:
    """A table of estimates with intervals, flags and, where some are known, true values.

    Args:
        estimates: Estimates by name.
        truth: True values, by name; empty leaves the columns out.
    """
    header = [("parameter", "key"), ("value", _NUMBER), ("95 % interval", _NUMBER), ("unit", ""), ("identifiable", "")]
    if truth:
        header += [("ground truth", _NUMBER), ("error", _NUMBER)]
    header.append(("note", "note"))
    rows = []
    for name, estimate in estimates.items():
        row = [text(name), *_numbers(estimate), text("" if estimate.unit == "1" else estimate.unit)]
        row.append('<span class="yes">yes</span>' if estimate.identifiable else '<span class="no">no</span>')
        if truth:
            row += _comparison(estimate, truth.get(name))
        rows.append([*row, text(estimate.note)])
    return table(header, rows)


def _numbers(estimate: Estimate) -> tuple[str, str]:
    """Value and interval in words, both to the digits that the interval leaves."""
    if estimate.interval is None:
        return f"{estimate.value:.4g}", "–"
    low, high = estimate.interval
    digits = _digits(estimate.value, high - low)
    return _rounded(estimate.value, digits), f"{_rounded(low, digits)} to {_rounded(high, digits)}"


def _digits(value: float, width: float) -> int:
    """Number of significant digits, 3 to 8, that an interval of this width leaves of a value."""
    if not (0.0 < width < math.inf) or value == 0.0:
        return 4
    return min(max(1 + math.ceil(math.log10(abs(value) / width)), 3), 8)


def _rounded(value: float, digits: int) -> str:
    if math.isinf(value):
        return "∞" if value > 0 else "−∞"
    return f"{value:#.{digits}g}".rstrip(".") if value else "0"


def _comparison(estimate: Estimate, truth: float | None) -> tuple[str, str]:
    """The true value and the error in per cent of it."""
    if truth is None:
        return "–", "–"
    error = f"{100 * (estimate.value - truth) / abs(truth):+.1f} %" if truth else f"{estimate.value - truth:+.3g}"
    return f"{truth:.4g}", error
