# SPDX-License-Identifier: MIT
"""Declaration of requests: fields with help, unit, range and group, checked by pydantic."""

import dataclasses
from collections.abc import Iterator
from typing import Annotated, Any, Literal, TypeVar, dataclass_transform, get_args, get_origin, get_type_hints

from pydantic import ConfigDict, Field, ValidationError
from pydantic.dataclasses import dataclass
from pydantic.fields import FieldInfo

from pinwm_drake.errors import ParameterError
from pinwm_drake.validation import first_problem, words

Group = Literal["Goal", "Data", "Budget", "Lab", "Advanced"]
GOAL, DATA, BUDGET, LAB, ADVANCED = get_args(Group)
Completes = Literal["twin", "scene", "policy", "bundle", "capture", "choice", ""]
_Class = TypeVar("_Class", bound=type)
_Any = TypeVar("_Any")


@dataclasses.dataclass(frozen=True)
class Shown:
    """Appearance of a field on the command line.

    Attributes:
        group: Panel of the help.
        names: Names of the option, such as ("--out", "-o"); empty for that of the field.
        metavar: Name of the value in the help; empty for that of its type.
        default: Default in words; empty for the value itself.
        completes: Kind of the values that the shell completes.
        argument: Flag: the field is an argument, which has no option's name.
        result: Place of the resolved configuration: "inside" the folder that is the value, or "beside" it.
        hidden: Flag: the help leaves it out.
        flatten: Flag: the field is a request of its own, whose fields are options of the command.
    """

    group: Group = "Goal"
    names: tuple[str, ...] = ()
    metavar: str = ""
    default: str = ""
    completes: Completes = ""
    argument: bool = False
    result: Literal["inside", "beside", ""] = ""
    hidden: bool = False
    flatten: bool = False


def option(
    text: str,
    *names: str,
    group: Group = "Goal",
    unit: str = "1",
    ge: float | None = None,
    gt: float | None = None,
    le: float | None = None,
    lt: float | None = None,
    multiple_of: float | None = None,
    allowed: str = "",
    **shown: Any,
) -> FieldInfo:
    """Annotation of a field that is an option of a command.

    Args:
        text: Help, which stands alone.
        names: Names of the option where they are not the field's.
        group: Panel of the help.
        unit: Unit of the value; "1" for none.
        ge: Least value.
        gt: Bound that values exceed.
        le: Largest value.
        lt: Bound that values stay below.
        multiple_of: Number that values are multiples of.
        allowed: Allowed values in words, where the bounds do not say them.
        shown: Other fields of `Shown`.
    """
    extra: dict[str, Any] = {"unit": unit, "shown": Shown(group=group, names=names, **shown)}
    extra |= {"allowed": allowed} if allowed else {}
    info: FieldInfo = Field(
        description=text, ge=ge, gt=gt, le=le, lt=lt, multiple_of=multiple_of, json_schema_extra=extra
    )
    return info


def argument(text: str, metavar: str, **shown: Any) -> FieldInfo:
    """Annotation of a field that is an argument of a command; see `option`."""
    return option(text, metavar=metavar, argument=True, **shown)


FLATTEN = Field(json_schema_extra={"shown": Shown(flatten=True)})  # type: ignore[dict-item]
"""Annotation of a field whose own fields are options of the command."""


@dataclass_transform(frozen_default=True)
def request(cls: _Class) -> _Class:
    """Make a class a frozen dataclass whose fields are checked; a wrong one is a ParameterError that names the option.

    A field without `option` or `argument` is for Python only.
    """
    made: Any = dataclass(
        frozen=True,
        config=ConfigDict(extra="forbid", arbitrary_types_allowed=True, allow_inf_nan=False, defer_build=True),
    )(cls)
    check = made.__init__

    def __init__(self: Any, *args: Any, **values: Any) -> None:
        for name, value in values.items():
            field = made.__pydantic_fields__.get(name)
            if isinstance(value, bool) and field is not None and not _takes_flags(field):
                allowed = words(field.annotation, field)
                raise ParameterError(f"{option_name(name, shown_of(field))}: got {value}; allowed: {allowed}")
        try:
            check(self, *args, **values)
        except ValidationError as error:
            raise ParameterError(_words(error, made)) from None
        finally:
            made.__init__ = __init__  # pydantic sets its own when it builds what it has deferred

    made.__init__ = __init__
    return made


def _takes_flags(field: FieldInfo) -> bool:
    """Flag: a field takes true and false, which are numbers to pydantic."""
    kinds = (field.annotation, *get_args(field.annotation))
    return bool in kinds or Any in kinds


def _words(error: ValidationError, cls: type) -> str:
    problem = first_problem(error, cls)
    key = next((part for part in reversed(problem.location) if isinstance(part, str)), "")
    name = option_name(key, shown_of(problem.field))
    if problem.kind in ("missing", "extra_forbidden"):
        return f"{name}: got {'none' if problem.kind == 'missing' else 'an unknown option'}; allowed: {problem.allowed}"
    return f"{name}: got {problem.value!r}; allowed: {problem.allowed}"


def shown_of(field: FieldInfo | None) -> Shown | None:
    """Appearance of a field; None for one that is for Python only."""
    extra = field.json_schema_extra if field is not None else None
    found = extra.get("shown") if isinstance(extra, dict) else None
    return found if isinstance(found, Shown) else None


def option_name(field: str, shown: Shown | None) -> str:
    """Name of a field on the command line, such as "--round-steps" or "TWIN"; its own where it is for Python only."""
    if shown is None:
        return field
    if shown.argument:
        return shown.metavar
    return shown.names[0] if shown.names else f"--{field.replace('_', '-')}"


@dataclasses.dataclass(frozen=True)
class RequestField:
    """A field of a request as the command line needs it.

    Attributes:
        name: Name of the field.
        kind: Type without its annotations.
        default: Default value; `dataclasses.MISSING` for none.
        info: Help, range and unit.
        shown: Appearance.
        owner: Field of the outer request that holds it; None where it is a field of that itself.
    """

    name: str
    kind: Any
    default: Any
    info: FieldInfo
    shown: Shown
    owner: str | None = None


def request_fields(cls: Any) -> Iterator[RequestField]:
    """Fields of a request that the command line shows, those of flattened ones in their place."""
    hints = get_type_hints(cls, include_extras=True)
    for field in dataclasses.fields(cls):
        kind = hints[field.name]
        infos = (
            [one for one in get_args(kind)[1:] if isinstance(one, FieldInfo)] if get_origin(kind) is Annotated else []
        )
        shown = shown_of(infos[0]) if infos else None
        if shown is None:
            continue
        plain = get_args(kind)[0]
        if shown.flatten:
            yield from (dataclasses.replace(one, owner=field.name) for one in request_fields(plain))
            continue
        default = field.default if field.default_factory is dataclasses.MISSING else field.default_factory()
        yield RequestField(field.name, plain, default, infos[0], shown)


def make_request(cls: type[_Any], values: dict[str, Any]) -> "_Any":
    """Request with values by field, those of flattened requests among them.

    Raises:
        ParameterError: A value is of the wrong kind or out of range.
    """
    mine, inner = dict(values), dict[str, dict[str, Any]]()
    for field in request_fields(cls):
        # A default is not checked: it may be what no one can ask for, such as an infinite box.
        if field.name in mine and field.default is not dataclasses.MISSING and mine[field.name] == field.default:
            del mine[field.name]
        if field.owner is not None and field.name in mine:
            inner.setdefault(field.owner, {})[field.name] = mine.pop(field.name)
    hints = get_type_hints(cls)
    return cls(**mine, **{name: make_request(hints[name], part) for name, part in inner.items()})
