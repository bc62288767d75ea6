# SPDX-License-Identifier: MIT
"""Commands made from requests: options with help, groups and completion, `--config`, and the resolved configuration."""

import dataclasses
import inspect
import os
import re
import types
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar, Union, get_args, get_origin

import typer
from rich.markup import escape

import pinwm_drake
from pinwm_drake.errors import InputError
from pinwm_drake.request import ADVANCED, RequestField, make_request, option_name, request_fields
from pinwm_drake.validation import bounds, unit_of, words

_Request = TypeVar("_Request")
_CONFIG = "config"
# Files that tell a folder's format, for completion.
_MARKS = {"twin": "twin.yaml", "policy": "policy.yaml", "bundle": "contract.yaml", "capture": "capture.yaml"}
_DEEPEST = 3  # folders below the one that is typed
_MOST = 200  # folders that are looked into


_OR_MORE = re.compile(r"([\d.e-]+) or more")


def add_command(
    app: typer.Typer, request: type[_Request], run: Callable[[_Request], None], *, name: str, example: str
) -> None:
    """Add the command of a request to an application.

    Args:
        app: The application, or a group of it.
        request: Class of the request, made by `pinwm_drake.request.request`.
        run: Function that does the work; its docstring is the command's help.
        name: Name of the command.
        example: Command line that the help ends with.
    """
    fields = list(request_fields(request))

    def command(**values: Any) -> None:
        values.pop(_CONFIG)
        made = make_request(request, {key: value for key, value in values.items() if value is not None})
        try:
            run(made)
        except SystemExit:  # a verdict, or an interrupted run that can go on
            write_config(made, name)
            raise
        write_config(made, name)

    parameters = [_parameter(field) for field in fields]
    parameters.append(_config_parameter(fields, name))
    # An argument without a default comes first in a signature.
    parameters.sort(key=lambda one: one.default is not inspect.Parameter.empty)
    command.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    command.__annotations__ = {one.name: one.annotation for one in parameters}
    command.__doc__ = run.__doc__
    command.request = request  # type: ignore[attr-defined]  # for the reference pages
    app.command(name, epilog=f"Example: {example}")(command)


def _parameter(field: RequestField) -> inspect.Parameter:
    """Parameter of a function that typer reads as an option or an argument."""
    shown, missing = field.shown, field.default is dataclasses.MISSING
    kind, choices = _typer_kind(field.kind)
    settings: dict[str, Any] = {
        "help": _help(field, choices),
        "hidden": shown.hidden,
        "rich_help_panel": "Arguments" if shown.argument else shown.group,
        "metavar": _metavar(field, kind),
        "show_default": False,
    }
    if shown.completes or choices:
        settings["autocompletion"] = completer(shown.completes, choices)
    if shown.argument:
        about = typer.Argument(**settings)
    else:
        name = option_name(field.name, shown)
        both = kind is bool and field.default is True and "/" not in name
        about = typer.Option(*([f"{name}/--no-{name[2:]}"] if both else shown.names or [name]), **settings)
    default = inspect.Parameter.empty if missing else _plain(field.default)
    annotation: Any = Annotated[kind, about]
    return inspect.Parameter(field.name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=annotation)


def _metavar(field: RequestField, kind: Any) -> str:
    """Name of a value in the help, with its unit in brackets: "[m]", "X Y [m]" or "NAME"."""
    unit = unit_of(field.info)
    if field.shown.metavar or unit != "1":
        return " ".join(filter(None, (field.shown.metavar, "" if unit == "1" else f"[{unit}]")))
    if kind is bool:
        return "flag"
    inner = next((part for part in get_args(kind) if part is not types.NoneType), kind)
    return {int: "N", float: "X", Path: "PATH"}.get(inner, "NAME")


def _help(field: RequestField, choices: tuple[str, ...]) -> str:
    """Help of an option: its text, what it allows, and its default."""
    text, shown, default = str(field.info.description).rstrip("."), field.shown, field.default
    if choices:
        text += f". One of {', '.join(choices)}"
    elif not shown.argument and (allowed := bounds(field.info)):
        text += _OR_MORE.sub(r"≥ \1", f" ({allowed})")
    told = not any(default is one for one in (None, False, True, dataclasses.MISSING)) and default != ()
    given = shown.default or (" ".join(map(str, default if isinstance(default, tuple) else [default])) if told else "")
    return escape(f"{text}." + (f" [default: {given}]" if given else ""))


def _typer_kind(kind: Any) -> tuple[Any, tuple[str, ...]]:
    """Type of an option as typer takes it, and the choices of a `Literal`."""
    inner, optional = kind, False
    if get_origin(kind) in (Union, types.UnionType):
        inner = next(part for part in get_args(kind) if part is not types.NoneType)
        optional = True
    choices: tuple[str, ...] = ()
    if get_origin(inner) is Annotated:
        inner = get_args(inner)[0]
    if get_origin(inner) is Literal:
        choices, inner = tuple(str(one) for one in get_args(inner)), str
    elif get_origin(inner) is tuple and Ellipsis in get_args(inner):
        inner, optional = list[get_args(inner)[0]], True  # type: ignore[misc]
    return (inner | None if optional else inner), choices


def _plain(default: Any) -> Any:
    return None if default == () else default


def _config_parameter(fields: list[RequestField], command: str) -> inspect.Parameter:
    """Return the option `--config`: values from a YAML file stand in for defaults."""

    def read(context: typer.Context, path: Path | None) -> Path | None:
        if path is not None:
            context.default_map = {**(context.default_map or {}), **read_config(path, fields, command)}
        return path

    about = typer.Option(
        "--config",
        metavar="FILE",
        is_eager=True,
        callback=read,
        help="YAML file of options by name. Options on the command line win.",
        rich_help_panel=ADVANCED,
        show_default=False,
    )
    annotation = Annotated[Path | None, about]
    return inspect.Parameter(_CONFIG, inspect.Parameter.KEYWORD_ONLY, default=None, annotation=annotation)


def read_config(path: Path, fields: list[RequestField], command: str) -> dict[str, Any]:
    """Values of a configuration file by field.

    Args:
        path: YAML file: a mapping from names of options, with dashes or underscores, to values.
        fields: Fields of the command's request.
        command: Name of the command.

    Raises:
        InputError: The file cannot be read, is of another command, or names an option that the command does not have.
    """
    from pinwm_drake.documents import read_yaml

    document = read_yaml(path)
    known = {field.name: field for field in fields}
    names = {option_name(field.name, field.shown).lstrip("-").replace("-", "_").lower(): field.name for field in fields}
    if not isinstance(document.value, dict):
        raise document.refusal("a mapping with names of options")
    if document.value.get("command", command) != command:
        raise document["command"].refusal(command)
    values: dict[str, Any] = {}
    for key in document.value:
        if key in ("command", "version"):
            continue
        plain = str(key).replace("-", "_").lower()
        field = known.get(plain) or known.get(names.get(plain, ""))
        if field is None:
            raise InputError(path, value=f"an unknown option {key!r}", allowed=", ".join(known))
        if document.value[key] is not None:
            values[field.name] = _checked(document[key], field)
    return values


def _checked(entry: Any, field: RequestField) -> Any:
    """Return a value of a configuration file, checked by its field."""
    from pydantic import TypeAdapter, ValidationError

    adapter: Any = TypeAdapter(Annotated[field.kind, field.info])  # type: ignore[arg-type]
    try:
        value = adapter.validate_python(entry.value)
    except ValidationError:
        raise entry.refusal(words(field.kind, field.info)) from None
    if isinstance(value, tuple | list):
        return [str(one) if isinstance(one, Path) else one for one in value]
    return str(value) if isinstance(value, Path) else value


def write_config(request: Any, command: str) -> None:
    """Write the resolved configuration of a command with its result, as COMMAND.config.yaml.

    Args:
        request: The request. A result that was not asked for, or is not there, has none.
        command: Name of the command.
    """
    from pinwm_drake.documents import yaml_text
    from pinwm_drake.files import replacing

    document: dict[str, Any] = {"command": command, "version": pinwm_drake.__version__}
    path, end = None, f"{command.replace(' ', '-')}.config.yaml"
    for field in request_fields(type(request)):
        value = getattr(request if field.owner is None else getattr(request, field.owner), field.name)
        document[field.name] = _yaml(value)
        if field.shown.result and value is not None and path is None:
            path = value / end if field.shown.result == "inside" else value.with_name(f"{value.stem}.{end}")
    if path is not None and path.parent.is_dir():
        with replacing(path) as temporary:
            temporary.write_text(yaml_text(document), encoding="utf-8")


def _yaml(value: Any) -> Any:
    if isinstance(value, tuple | list):
        return [_yaml(one) for one in value]
    return str(value) if isinstance(value, Path) else value


def completer(kind: str, choices: tuple[str, ...]) -> Callable[[str], list[str]]:
    """Return the function that gives the values of a kind that begin with a text.

    Args:
        kind: "twin", "scene", "policy", "bundle", "capture", "choice" or "".
        choices: Values of a choice.
    """

    def complete(incomplete: str) -> list[str]:
        found = [*choices, *_shipped(kind)]
        if kind in ("twin", "policy", "bundle", "capture", "scene"):
            found += _folders(kind, incomplete)
        return [one for one in found if one.startswith(incomplete)]

    return complete


def _shipped(kind: str) -> list[str]:
    """Names that ship with the package."""
    from pinwm_drake import models

    if kind in ("policy", "bundle"):
        return [*models.shipped_policies(), *(["mpc", "random"] if kind == "policy" else [])]
    return list(models.shipped_scenarios()) if kind in ("scene", "twin") else []


def _folders(kind: str, incomplete: str) -> Iterator[str]:
    """Paths of folders of a format, and of scenario files, that begin with a text."""
    head = os.path.dirname(incomplete)
    start, left = Path(head or "."), _MOST
    marks = {"scene": ("twin.yaml",), "policy": ("policy.yaml", "contract.yaml")}.get(kind, (_MARKS.get(kind, ""),))
    queue = [(start, 0)]
    while queue and left:
        folder, depth = queue.pop(0)
        left -= 1
        try:
            entries = sorted(os.scandir(folder), key=lambda entry: entry.name)
        except OSError:
            continue
        for entry in entries:
            path = Path(folder, entry.name)
            if kind == "scene" and entry.name.endswith(".scenario.yaml"):
                yield str(path)
            if entry.is_dir() and not entry.name.startswith("."):
                if any((path / mark).is_file() for mark in marks):
                    yield str(path)
                elif depth + 1 < _DEEPEST:
                    queue.append((path, depth + 1))
