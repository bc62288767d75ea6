# SPDX-License-Identifier: MIT
"""JSON and YAML files whose every entry knows its file and its place in it, so that an error can name both."""

import json
import math
import reprlib
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, TypeVar

import numpy as np
import yaml
from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, ValidationError

from pinwm_drake.errors import InputError
from pinwm_drake.reading.contents import read_text
from pinwm_drake.reading.trees import MOST_JSON, MOST_YAML, YamlDumper, parse_json, parse_yaml
from pinwm_drake.validation import Problem, all_problems, first_problem, place

LONGEST_TEXT = 1000  # characters: names and paths
ROUND_CONE = "the friction cone is round"  # why `friction_directions` has no effect
_LONGEST_QUOTE = 60  # characters of a value that a message repeats
# Documents may hold lists in lists in lists, the same one many times: a message shows the outermost.
_shortened = reprlib.Repr()
_shortened.maxlevel, _shortened.maxlist, _shortened.maxdict, _shortened.maxstring = 2, 6, 4, 20


class Document(BaseModel):
    """Base of the models of documents: no other keys, no conversion of types, no NaN."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False)


_Document = TypeVar("_Document", bound=Document)


@dataclass(frozen=True)
class Entry:
    """Entry of a document: a value with its file and its place.

    Files of others are read by entries: their keys stand in for one another, and matrices make a model longer.

    Attributes:
        path: The file.
        place: Place in the file, as in `frames[2].fl_x`; empty for the whole document.
        value: The value at that place.
    """

    path: Path
    place: str
    value: Any

    def refusal(self, allowed: str, found: str | None = None) -> InputError:
        """Return the error that names file, place and value.

        Args:
            allowed: Values that would have been accepted, in words.
            found: The finding, in words; None for the value itself.
        """
        found = _quoted(self.value) if found is None else found
        return InputError(self.path, value=f"{self.place} = {found}" if self.place else found, allowed=allowed)

    def read(self, model: type[_Document]) -> _Document:
        """Return the value as a model has it.

        Raises:
            InputError: A key is missing or unknown, or a value is not allowed; the message names its place.
        """
        try:
            return model.model_validate(self.value)
        except ValidationError as error:
            raise self._problem(first_problem(error, model)) from error

    def problems(self, model: type[Document]) -> list[InputError]:
        """All problems that `read` finds, in the order of the model's fields."""
        try:
            model.model_validate(self.value)
        except ValidationError as error:
            return [self._problem(problem) for problem in all_problems(error, model)]
        return []

    def _problem(self, problem: Problem) -> InputError:
        if problem.kind == "extra_forbidden":
            name, where = _quoted(problem.location[-1]), self._below(problem.location[:-1])
            found = f"an unknown key {name}{f' under {where}' if where else ''}"
            return InputError(self.path, value=found, allowed=problem.allowed)
        where, value = self._below(problem.location), self.value
        try:
            for part in problem.location:
                value = value[part]
        except KeyError:
            allowed = f"a value under {where}" if problem.kind == "missing" else problem.allowed
            return InputError(self.path, value=f"no {where}", allowed=allowed)
        return Entry(self.path, where, value).refusal(problem.allowed)

    def _below(self, location: tuple[str | int, ...]) -> str:
        return place((self.place, *location) if self.place else location)

    def find(self, key: str) -> "Entry | None":
        """Return the entry under a key, or None where there is none.

        Raises:
            InputError: This entry is not a mapping.
        """
        if not isinstance(self.value, dict):
            raise self.refusal("a mapping with keys")
        return Entry(self.path, self._below((key,)), self.value[key]) if key in self.value else None

    def __getitem__(self, key: str) -> "Entry":
        """Return the entry under a key.

        Raises:
            InputError: There is no such key, or this entry is not a mapping.
        """
        if (entry := self.find(key)) is None:
            where = self._below((key,))
            raise InputError(self.path, value=f"no {where}", allowed=f"a value under {where}")
        return entry

    def only(self, *keys: str) -> None:
        """Require a mapping without other keys than these.

        Raises:
            InputError: There is another key, or this entry is not a mapping.
        """
        if not isinstance(self.value, dict):
            raise self.refusal("a mapping with keys")
        for key in self.value:
            if key not in keys:
                found = f"an unknown key {_quoted(key)}" + (f" under {self.place}" if self.place else "")
                raise InputError(self.path, value=found, allowed=", ".join(keys))

    def without(self, key: str, reason: str) -> "Entry":
        """Entry without a key that has no effect any more; the first time in a process, a warning names it.

        Args:
            key: The key, which need not be there.
            reason: Why it has no effect.

        Raises:
            InputError: This entry is not a mapping.
        """
        found = self.find(key)
        if found is None:
            return self
        warn_without_effect(self.path, found.place, reason)
        return Entry(self.path, self.place, {name: value for name, value in self.value.items() if name != key})

    def items(self) -> "list[Entry]":
        """Return the entries of a list that is not empty.

        Raises:
            InputError: This entry is not a list, or an empty one.
        """
        if not isinstance(self.value, list) or not self.value:
            raise self.refusal("a list with one entry or more")
        return [Entry(self.path, f"{self.place}[{k}]", value) for k, value in enumerate(self.value)]

    def text(self) -> str:
        """Return a text that is not empty and can be printed.

        Raises:
            InputError: This entry is something else.
        """
        if not isinstance(self.value, str):
            raise self.refusal("text")
        try:
            return _text(self.value)
        except ValueError as error:
            raise self.refusal(str(error)) from error

    def number(self, low: float = -math.inf, high: float = math.inf) -> float:
        """Return a finite number from `low` to `high`.

        Raises:
            InputError: This entry is something else.
        """
        value = _number(self.value)
        if value is None or not low <= value <= high:
            raise self.refusal(_allowed(low, high))
        return value

    def integer(self, low: int, high: int) -> int:
        """Return a whole number from `low` to `high`.

        Raises:
            InputError: This entry is something else.
        """
        value = _number(self.value)
        if value is None or value != round(value) or not low <= value <= high:
            raise self.refusal(f"a whole number from {low} to {high}")
        return round(value)

    def numbers(self, length: int, *rest: int) -> np.ndarray:
        """Return an array of finite numbers: float64 of shape (length, *rest), the unit that of the entry.

        Raises:
            InputError: The nested lists have another shape, or one number is not finite; the message names it.
        """
        if not isinstance(self.value, list) or len(self.value) != length:
            raise self.refusal(f"{' x '.join(map(str, (length, *rest)))} finite numbers")
        return np.array([entry.numbers(*rest) if rest else entry.number() for entry in self.items()], float)


_warned: set[str] = set()


def warn_without_effect(where: object, key: str, reason: str) -> None:
    """Warns of a setting that is accepted and has no effect; once in a process for each key.

    Args:
        where: File or command that has the setting.
        key: Its place in the file, or the option.
        reason: Why it has no effect.
    """
    if key not in _warned:
        _warned.add(key)
        warnings.warn(f"{where}: {key} has no effect: {reason}; delete it", FutureWarning, stacklevel=2)


def _allowed(low: float, high: float) -> str:
    return "a finite number" + ("" if math.isinf(low) and math.isinf(high) else f" from {low:g} to {high:g}")


def in_words(allowed: str, **bounds: Any) -> Any:
    """Field with pydantic's bounds; a message says what is allowed in these words."""
    return Field(json_schema_extra={"allowed": allowed}, **bounds)


def finite(low: float = -math.inf, high: float = math.inf) -> Any:
    """Field of a finite number from `low` to `high`."""
    return in_words(_allowed(low, high), ge=low, le=high)


def schema_version(number: int) -> Any:
    """Field of the version of a document, a whole number; no Literal, as True is 1."""
    return in_words(f"{number}, the version that this release reads", ge=number, le=number)


def _text(text: str) -> str:
    if not text.strip() or not text.isprintable():
        raise ValueError("text")
    if len(text) > LONGEST_TEXT:
        raise ValueError(f"text of at most {LONGEST_TEXT} characters")
    return text


Text = Annotated[str, AfterValidator(_text)]  # not empty, printable
Number = Annotated[float, finite()]
# YAML and JSON have lists where Python has tuples.
FromList = BeforeValidator(lambda value: tuple(value) if isinstance(value, list) else value)


def read_json(path: Path) -> Entry:
    """Read a JSON file as a document.

    Raises:
        InputError: It is missing, unreadable, not JSON, too long or too deep; the message names the line.
    """
    return Entry(path, "", parse_json(read_text(path, MOST_JSON), path))


def read_yaml(path: Path) -> Entry:
    """Read a YAML file of plain data.

    Raises:
        InputError: It is missing, unreadable, not YAML, too long or too deep; the message names the line.
    """
    return Entry(path, "", parse_yaml(read_text(path, MOST_YAML), path))


def yaml_text(value: Any) -> str:
    """Text of plain data in its order, which `read_yaml` reads as the same values; tuples become lists."""
    text = yaml.dump(value, Dumper=YamlDumper, default_flow_style=None, sort_keys=False, allow_unicode=True, width=110)
    return str(text)


def _quoted(value: object) -> str:
    """Return a value as a message repeats it: on one line, printable, and not too long of it."""
    if isinstance(value, str) and len(value) > _LONGEST_QUOTE:
        value = value[:_LONGEST_QUOTE] + "..."
    if isinstance(value, (list, dict)):
        return _shortened.repr(value)
    if isinstance(value, int) and value.bit_length() > 10_000:  # Python does not print those
        return "a whole number of thousands of digits"
    text = json.dumps(value, default=ascii)
    return text if len(text) <= 2 * _LONGEST_QUOTE else text[:_LONGEST_QUOTE] + "..."


def _number(value: object) -> float | None:
    """Return a finite number, or None for anything else (true and false too)."""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return None
    try:
        number = float(value)
    except OverflowError:
        return None
    return number if math.isfinite(number) else None
