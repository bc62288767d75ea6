"""The check of a training's settings."""

import math
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from pinwm_drake.errors import ParameterError


def check_options(options: Any, least: Mapping[str, float]) -> None:
    """Checks that all numbers of a dataclass are finite and positive.

    Args:
        options: The dataclass.
        least: Of those that may also be other than positive: 0, or minus infinity.

    Raises:
        ParameterError: One is out of range.
    """
    for name, value in asdict(options).items():
        lowest = least.get(name)
        if not math.isfinite(value) or (value <= 0 if lowest is None else value < lowest):
            allowed = {None: "more than 0", 0.0: "0 or more"}.get(lowest, "a finite number")
            raise ParameterError(f"{name}: got {value}; allowed: {allowed}")
