"""Errors of pydantic in one line: place, value and what is allowed, with the unit.

Fields tell their unit by `json_schema_extra={"unit": "m"}`, and what is allowed by an entry "allowed" in words where
bounds and choices do not say it.
"""

import types
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Literal, Union, get_args, get_origin

import annotated_types
from pydantic import ValidationError
from pydantic.fields import FieldInfo


@dataclass(frozen=True)
class Problem:
    """First thing that pydantic found wrong.

    Attributes:
        kind: Kind of the problem, as pydantic names it: "missing", "extra_forbidden", "greater_than_equal", ...
        location: Keys and indices from the outermost value to the wrong one.
        value: The wrong value.
        field: Field that holds it, or that its list is in; None for a whole document and for an unknown key.
        allowed: What is allowed, in words.
    """

    kind: str
    location: tuple[str | int, ...]
    value: Any
    field: FieldInfo | None
    allowed: str

    @property
    def place(self) -> str:
        """Place of the wrong value, such as `frames[2].fl_x`; empty for the whole document."""
        return place(self.location)


def place(location: Sequence[str | int]) -> str:
    """Keys and indices as text, such as `frames[2].fl_x`."""
    parts = (f"[{part}]" if isinstance(part, int) else f".{part}" for part in location)
    return "".join(parts).removeprefix(".")


def first_problem(error: ValidationError, model: type) -> Problem:
    """First problem of a validation.

    Args:
        error: Error that pydantic raised.
        model: Model or pydantic dataclass that was validated.
    """
    return all_problems(error, model)[0]


def all_problems(error: ValidationError, model: type) -> list[Problem]:
    """Problems of a validation, in pydantic's order; arguments as for `first_problem`."""
    return [_problem(found, model) for found in error.errors(include_url=False)]


def _problem(found: Any, model: type) -> Problem:
    kind, location = found["type"], tuple(found["loc"])
    if location and location[-1] == "[key]":
        field, _ = _find(model, location[:-2])
        return Problem("invalid_key", location[:-2], None, field, "a mapping whose keys are text")
    if kind == "missing" and isinstance(location[-1], int):  # a list that is too short
        kind, location = "too_short", location[:-1]
    if kind in ("extra_forbidden", "unexpected_keyword_argument", "invalid_key"):
        owner = _find(model, location[:-1])[1]
        return Problem("extra_forbidden", location, found["input"], None, ", ".join(fields_of(owner)))
    field, annotation = _find(model, location)
    if kind in ("missing", "missing_argument"):
        return Problem("missing", location, None, field, f"a value under {place(location)}")
    if kind == "value_error" and "error" in found.get("ctx", {}):
        return Problem(kind, location, found["input"], field, str(found["ctx"]["error"]))
    return Problem(kind, location, found["input"], field, words(annotation, field))


def fields_of(model: Any) -> dict[str, FieldInfo]:
    """Fields of a model or pydantic dataclass by name; none of anything else."""
    return getattr(model, "__pydantic_fields__", {})


def words(annotation: Any, field: FieldInfo | None) -> str:
    """Words for what a field allows, such as "1 to 64" or "more than 0 m", in plain English.

    Args:
        annotation: Type of the field, or of an entry of its list.
        field: The field, with bounds and unit.
    """
    kind, optional, metadata = _plain(annotation)
    # What an entry of a list says about itself goes before what is said of the list.
    extra = {key: value for one in (field, *metadata) for key, value in _extra(one).items()}
    if "allowed" in extra:
        return str(extra["allowed"])
    metadata = [*metadata, *(field.metadata if field is not None else [])]
    if get_origin(kind) is Literal:
        return ", ".join([*(str(choice) for choice in get_args(kind)), *(["null"] if optional else [])])
    if get_origin(kind) in (list, tuple):
        parts = [_plain(part)[0] for part in get_args(kind) if part is not Ellipsis]
        count = len(parts) if get_origin(kind) is tuple and Ellipsis not in get_args(kind) else None
        return f"{count} {_KINDS.get(parts[0], 'value')}s" if count else f"a list of {_KINDS.get(parts[0], 'value')}s"
    unit = f" {extra['unit']}" if extra.get("unit", "1") != "1" else ""
    if kind in (int, float):
        return (_bounds(metadata) or f"a {_KINDS[kind]}") + unit
    if fields_of(kind) or dict in (kind, get_origin(kind)):
        return "a mapping with keys"
    return {str: "text", bool: "true, false"}.get(kind, getattr(kind, "__name__", str(kind)).lower())


def _extra(one: Any) -> dict[str, Any]:
    found = one.json_schema_extra if isinstance(one, FieldInfo) else None
    return found if isinstance(found, dict) else {}


_KINDS: dict[Any, str] = {int: "whole number", float: "finite number", str: "text", bool: "flag"}


def _bounds(metadata: Sequence[Any]) -> str:
    low = high = ""
    for one in metadata:
        if isinstance(one, annotated_types.Ge):
            low = f"{one.ge:g}"
        elif isinstance(one, annotated_types.Gt):
            low = f"more than {one.gt:g}"
        elif isinstance(one, annotated_types.Le):
            high = f"{one.le:g}"
        elif isinstance(one, annotated_types.Lt):
            high = f"less than {one.lt:g}"
    if low and high:
        closed = not low.startswith("more") and not high.startswith("less")
        return f"{low} to {high}" if closed else f"{low}, {high if high.startswith('less') else f'up to {high}'}"
    if low:
        return low if low.startswith("more") else f"{low} or more"
    return high if not high or high.startswith("less") else f"up to {high}"


def _plain(annotation: Any) -> tuple[Any, bool, list[Any]]:
    """Type without `Annotated` and None, whether None is allowed, and the metadata that was on the way."""
    optional, metadata = False, []
    while True:
        if get_origin(annotation) is Annotated:
            annotation, *more = get_args(annotation)
            metadata += [inner for one in more for inner in (one, *getattr(one, "metadata", ()))]
        elif get_origin(annotation) in (Union, types.UnionType):
            parts = [part for part in get_args(annotation) if part is not types.NoneType]
            optional, annotation = optional or len(parts) < len(get_args(annotation)), parts[0]
        else:
            return annotation, optional, metadata


def _find(model: Any, location: Sequence[str | int]) -> tuple[FieldInfo | None, Any]:
    """Field at a location, and the type there."""
    field: FieldInfo | None = None
    for part in location:
        model, _, _ = _plain(model)
        if isinstance(part, int):
            inner = [one for one in get_args(model) if one is not Ellipsis]
            model = inner[min(part, len(inner) - 1)] if inner else Any
        elif part in fields_of(model):
            field = fields_of(model)[part]
            model = field.annotation
        else:
            break
    return field, model
