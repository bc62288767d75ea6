"""Check of a training's settings."""

import math
from collections.abc import Collection
from dataclasses import asdict
from typing import Any

from pinwm_drake.errors import ParameterError


def check_options(options: Any, may_be_zero: Collection[str]) -> None:
    """Checks that all numbers of a dataclass are finite and positive; pairs of them are left to the caller.

    Args:
        options: The dataclass.
        may_be_zero: Names of the fields that may also be 0.

    Raises:
        ParameterError: A field is out of range.
    """
    for name, value in asdict(options).items():
        zero = name in may_be_zero
        if isinstance(value, tuple):
            continue
        if not (math.isfinite(value) and (value >= 0 if zero else value > 0)):
            raise ParameterError(f"{name}: got {value}; allowed: {'0 or more' if zero else 'more than 0'}")
