# SPDX-License-Identifier: MIT
"""Refusal of an input: its problem is raised, or handed on so that the rest gets checked too."""

from collections.abc import Callable
from typing import NoReturn, TypeVar

from pinwm_drake.errors import PinwmError

Refuse = Callable[[PinwmError], None]
_Result = TypeVar("_Result")


def raise_it(error: PinwmError) -> NoReturn:
    """Raise the error: the reader stops at the first problem."""
    raise error


def ignore(error: PinwmError) -> None:
    """Do nothing about an error, which something else tells."""


def attempt(work: Callable[[], _Result], refuse: Refuse) -> _Result | None:
    """Return the result of `work`, or None where it raised a PinwmError and `refuse`, which receives that, did not."""
    try:
        return work()
    except PinwmError as error:
        refuse(error)
        return None
