"""Refusal of an input: its problem is raised, or handed on so that the rest gets checked too."""

from collections.abc import Callable
from typing import NoReturn, TypeVar

from pinwm_drake.errors import PinwmError

Refuse = Callable[[PinwmError], None]
_Result = TypeVar("_Result")


def raise_it(error: PinwmError) -> NoReturn:
    """Raises the error: the reader stops at the first problem."""
    raise error


def ignore(error: PinwmError) -> None:
    """Does nothing about an error, which something else tells."""


def attempt(work: Callable[[], _Result], refuse: Refuse) -> _Result | None:
    """Result of `work`, or None where it was refused and `refuse` did not raise.

    Args:
        work: Function that reads something; may raise a PinwmError.
        refuse: Receives that error.
    """
    try:
        return work()
    except PinwmError as error:
        refuse(error)
        return None


def passes(work: Callable[[], None], refuse: Refuse) -> bool:
    """Flag: `work`, a check, found nothing to refuse.

    Args:
        work: Function that checks something; may raise a PinwmError.
        refuse: Receives that error.
    """
    try:
        work()
    except PinwmError as error:
        refuse(error)
        return False
    return True
