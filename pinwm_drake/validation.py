# SPDX-License-Identifier: MIT
"""Errors of pydantic in one line: place, value and what is allowed, with the unit.

Fields tell their unit by `json_schema_extra={"unit": "m"}`, and what is allowed by an entry "allowed" in words where
bounds and choices do not say it.
"""

import types
from collections.abc import Sequence
from dataclasses import dataclass, fields, is_dataclass
from functools import cache
from typing import Annotated, Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

import annotated_types
from pydantic import BaseModel, BeforeValidator, ConfigDict, ValidationError, create_model
from pydantic.fields import FieldInfo

from pinwm_drake.errors import ParameterError

_Dataclass = TypeVar("_Dataclass")


class Refusal(ValueError):
    """Error of a validator about one entry of what it validates."""

    def __init__(self, allowed: str, key: str | int) -> None:
        """Error with what is allowed, in words, and key or index of the wrong entry."""
        super().__init__(allowed)
        self.key = key


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
        error, value = found["ctx"]["error"], found["input"]
        if isinstance(error, Refusal) and (not isinstance(value, dict) or error.key in value):
            location, value = (*location, error.key), value[error.key]
        return Problem(kind, location, value, field, str(error))
    return Problem(kind, location, found["input"], field, words(annotation, field))


def fields_of(model: Any) -> dict[str, FieldInfo]:
    """Fields of a model or dataclass by name; none of anything else."""
    model, _, _ = _plain(model)
    if is_dataclass(model) and not hasattr(model, "__pydantic_fields__"):
        return {name: FieldInfo.from_annotation(hint) for name, hint in _hints(model).items()}
    return getattr(model, "__pydantic_fields__", {})


def _hints(kind: Any) -> dict[str, Any]:
    hints = get_type_hints(kind, include_extras=True)
    return {field.name: hints[field.name] for field in fields(kind)}


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
    if get_origin(kind) is Literal:
        return ", ".join([*(str(choice) for choice in get_args(kind)), *(["null"] if optional else [])])
    if get_origin(kind) in (list, tuple):
        parts = [_plain(part)[0] for part in get_args(kind) if part is not Ellipsis]
        count = len(parts) if get_origin(kind) is tuple and Ellipsis not in get_args(kind) else None
        return f"{count} {_KINDS.get(parts[0], 'value')}s" if count else f"a list of {_KINDS.get(parts[0], 'value')}s"
    if kind in (int, float):
        unit = f" {extra['unit']}" if extra.get("unit", "1") != "1" else ""
        return (bounds(field, metadata) or f"a {_KINDS[kind]}") + unit
    if fields_of(kind) or dict in (kind, get_origin(kind)):
        return "a mapping with keys"
    return {str: "text", bool: "true, false"}.get(kind, getattr(kind, "__name__", str(kind)).lower())


def _extra(one: Any) -> dict[str, Any]:
    found = one.json_schema_extra if isinstance(one, FieldInfo) else None
    return found if isinstance(found, dict) else {}


_KINDS: dict[Any, str] = {int: "whole number", float: "finite number", str: "text", bool: "flag"}


def unit_of(field: FieldInfo | None) -> str:
    """Return the unit of a field, such as "m"; "1" for none."""
    extra = field.json_schema_extra if field is not None else None
    return str(extra.get("unit", "1")) if isinstance(extra, dict) else "1"


def bounds(field: FieldInfo | None, more: Sequence[Any] = ()) -> str:
    """Range of a number in words, such as "1 to 64" or "more than 0"; empty where it has no bounds.

    Args:
        field: The field; an entry "allowed" of it goes first.
        more: Further bounds, as `annotated_types` has them.
    """
    extra = field.json_schema_extra if field is not None else None
    if isinstance(extra, dict) and "allowed" in extra:
        return str(extra["allowed"])
    metadata = [*more, *(field.metadata if field is not None else [])]
    low = next((one for one in metadata if isinstance(one, annotated_types.Ge | annotated_types.Gt)), None)
    high = next((one for one in metadata if isinstance(one, annotated_types.Le | annotated_types.Lt)), None)
    least = None if low is None else _number(low.ge if isinstance(low, annotated_types.Ge) else low.gt)
    most = None if high is None else _number(high.le if isinstance(high, annotated_types.Le) else high.lt)
    above, below = isinstance(low, annotated_types.Gt), isinstance(high, annotated_types.Lt)
    if least and most and not above and not below:
        return f"{least} to {most}"
    parts = [f"more than {least}" if above else f"{least} or more"] if least else []
    parts += [f"less than {most}" if below else f"up to {most}"] if most else []
    return ", ".join(parts)


def _number(value: Any) -> str:
    return str(value) if isinstance(value, int) else f"{value:g}"


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
        elif get_origin(model) is dict:
            field, model = None, get_args(model)[1]
        elif part in fields_of(model):
            field = fields_of(model)[part]
            model = field.annotation
        else:
            break
    return field, model


def check_fields(instance: Any, place: str = "", *, as_given: bool = False) -> None:
    """Check the fields of a dataclass by their annotations, for `__post_init__`; numbers become plain ones.

    Lists and arrays become tuples. No number may be NaN or infinite, and none is taken from a text or a flag.

    Args:
        instance: The dataclass, of which the fields are set even where it is frozen.
        place: Place that messages put before a field's name, such as "scene.object."; empty for none.
        as_given: Flag: messages show a list as it was given, not as a tuple.

    Raises:
        ParameterError: A value is of the wrong kind or out of range.
    """
    model = _model(instance.__class__)
    given = {name: _tuples(getattr(instance, name)) for name in model.model_fields}
    try:
        checked = model.model_validate(given)
    except ValidationError as error:
        problem = first_problem(error, model)
        name = str(problem.location[0])
        shown = getattr(instance, name) if as_given else given[name]
        raise ParameterError(f"{place}{name}: got {shown!r}; allowed: {problem.allowed}") from None
    for name in given:
        object.__setattr__(instance, name, getattr(checked, name))


@cache
def _model(kind: type) -> type[BaseModel]:
    config = ConfigDict(strict=True, allow_inf_nan=False)
    hints: dict[str, Any] = {name: (hint, ...) for name, hint in _hints(kind).items()}
    return create_model(kind.__name__, __config__=config, **hints)


def _tuples(value: Any) -> Any:
    value = value.tolist() if hasattr(value, "tolist") else value
    return tuple(value) if isinstance(value, list) else value


def from_document(kind: type[_Dataclass], document: Any, place: str) -> _Dataclass:
    """Dataclass from a document with a value for each of its fields.

    Args:
        kind: The dataclass, which checks its fields itself; see `check_fields`.
        document: A mapping with the names of all fields as keys.
        place: Place of the document in messages.

    Raises:
        ParameterError: A key is missing or unknown, or a value is of the wrong kind or out of range.
    """
    names = [field.name for field in fields(kind)]  # type: ignore[arg-type]  # a dataclass
    if not isinstance(document, dict) or set(document) != set(names):
        given = sorted(map(str, document)) if isinstance(document, dict) else document
        raise ParameterError(f"{place}: got {given}; allowed: the keys {', '.join(names)}")
    return kind(**document)


def document_of(kind: type, place: str) -> BeforeValidator:
    """Annotation of a field that takes a dataclass or its document; arguments as for `from_document`."""
    return BeforeValidator(lambda value: value if isinstance(value, kind) else from_document(kind, value, place))
