# SPDX-License-Identifier: MIT
"""Sampling periods: the index of a period, whole multiples of one, and checks of such numbers.

Drake runs what is due at one instant together, and two instants are one only if they are equal to the last bit:
0.1 x 3 is not (1 / 240) x 72. So whatever is to happen together has events of one and the same period, and what
happens every N-th time counts.
"""

import math

from pinwm_drake.errors import ParameterError, require

# Of a period: far more than rounding makes of the quotient of a time and a period, up to 1e9 periods.
_ROUNDING = 1e-6


def period_index(t: float, period: float) -> int:
    """Index of the period that holds the time t: k for k period <= t < (k + 1) period, whatever rounding did to t."""
    return math.floor(t / period + _ROUNDING)


def whole_multiple(name: str, duration: float, period: float, of: str = "the period") -> int:
    """Return the number of periods in a duration, a whole one.

    Args:
        name: Name of the duration, for the message.
        duration: s.
        period: s.
        of: The name of the period, for the message.

    Raises:
        ParameterError: One is not positive, or their quotient is no whole number.
    """
    require_positive(name, duration, "s")
    require_positive(of, period, "s")
    count = round(duration / period)
    if count < 1 or abs(duration / period - count) > _ROUNDING:
        raise ParameterError(f"{name}: got {duration:g} s; allowed: a whole multiple of {of}, {period:g} s")
    return count


def require_positive(name: str, value: float, unit: str = "") -> float:
    """Return validated value, finite and more than 0; raises ParameterError otherwise."""
    require(name, f"{value:g}", 0 < value < math.inf, f"more than 0{unit and ' ' + unit}")
    return value
