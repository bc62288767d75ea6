# SPDX-License-Identifier: MIT
"""Exceptions of the package, one family. A message says what was given and what is allowed.

`pinwm` prints any `PinwmError` as one line and exits with 1, so a message has to be enough to mend the input.
"""

import importlib.util
import os
from typing import Any

_LONGEST = 280  # characters of a message: with the name of a command before it, a line is within 300
_CUT = " ... "
_MOST_READ = 10_000  # characters that are looked at
_LEAST = 60  # characters of a value that stay, however long path and allowed values are


class PinwmError(Exception):
    """Base of every error that pinwm_drake raises about what it was given; a message is one line, not too long."""

    def __init__(self, message: object = "") -> None:
        """Error with a message, of which line breaks go, and the middle where it is too long."""
        super().__init__(_shortened(one_line(message), _LONGEST))


class GeometryError(PinwmError):
    """A shape, mesh or decomposition is not usable: wrong size, not watertight, not convex, out of scale."""


class VersionError(PinwmError, ImportError):
    """An installed library is of a version that cannot be used."""


class ModelError(PinwmError):
    """A model's description contradicts itself: bodies, joints, pusher, floor or time step."""


class ParameterError(PinwmError):
    """A physical parameter or an option is outside its allowed range, or has the wrong shape."""


class StateError(PinwmError):
    """A state or an action has the wrong shape or dtype, or holds values that are not finite."""


class RenderingError(PinwmError):
    """Cameras, surfels or images do not fit together, or are out of range."""


class SolverError(PinwmError):
    """A solver stopped before it reached its tolerance.

    Attributes:
        worlds: Indices of the worlds that failed; empty where there is no telling.
    """

    def __init__(self, message: str, *, worlds: tuple[int, ...] = ()) -> None:
        """Error with a message and the indices of the worlds that failed."""
        super().__init__(message)
        self.worlds = worlds


class InputError(PinwmError):
    """A file or folder cannot be used.

    The message is composed as `PATH, row ROW: got VALUE; allowed: ALLOWED`, without what is unknown. A value that
    begins with "no", such as "no such file", stands without "got".

    Attributes:
        path: The file or folder.
        row: The line or record in it, counted from 1, or None.
        value: Value that was found there, or None.
        allowed: Values that would have been accepted, in words.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        *,
        allowed: str,
        row: int | None = None,
        value: object = None,
    ) -> None:
        """Composes the message from its parts.

        Args:
            path: The file or folder.
            allowed: Values that would have been accepted, in words.
            row: The line or record in it, counted from 1.
            value: Value that was found there.
        """
        self.path = os.fspath(path)
        self.row = row
        self.value = value
        self.allowed = allowed
        where = one_line(self.path if row is None else f"{self.path}, row {row}")
        allowed = one_line(allowed)
        left = _LONGEST - len(where) - len(allowed) - len(": got ; allowed: ")
        found = "" if value is None else f"got {_shortened(one_line(value), max(left, _LEAST))}; "
        if found.lower().startswith("got no "):  # it says what happened, and is no value that was given
            found = f"no {found[7:]}"
        super().__init__(f"{where}: {found}allowed: {allowed}")

    def __reduce__(self) -> tuple[Any, ...]:
        """Return constructor and arguments, for another process; a value goes as text."""
        value = None if self.value is None else str(self.value)
        return _input_error, (type(self), self.path, self.allowed, self.row, value)


def one_line(text: object) -> str:
    """Return a text on one line, with escapes for what cannot be printed."""
    words = " ".join(str(text)[:_MOST_READ].split())
    return words if words.isprintable() else "".join(one if one.isprintable() else ascii(one)[1:-1] for one in words)


def _shortened(text: str, length: int) -> str:
    """Return a text without its middle where it is longer than `length`; the end says what is allowed."""
    if len(text) <= length:
        return text
    end = (length - len(_CUT)) // 3
    return f"{text[: length - len(_CUT) - end]}{_CUT}{text[-end:]}"


def require(name: str, value: object, allowed: bool, range_in_words: str) -> None:
    """Check an option.

    Args:
        name: Of the option, as its user writes it.
        value: As it was given.
        allowed: The outcome of the check.
        range_in_words: The values that are allowed, for the message.

    Raises:
        ParameterError: The value is not allowed.
    """
    if not allowed:
        raise ParameterError(f"{name}: got {value}; allowed: {range_in_words}")


def require_package(name: str, extra: str, use: str) -> None:
    """Check that a package of an extra is installed.

    Args:
        name: Of the package, for pip and for Python.
        extra: Extra of pyproject.toml that brings it.
        use: What needs it, for the message.

    Raises:
        ParameterError: It is not installed.
    """
    if importlib.util.find_spec(name) is None:
        advice = f'pip install {name} (in a checkout: pip install -e ".[{extra}]")'
        raise ParameterError(f"{use}: {name} is not installed; run: {advice}")


def _input_error(kind: type[InputError], path: str, allowed: str, row: int | None, value: str | None) -> InputError:
    return kind(path, allowed=allowed, row=row, value=value)
