# SPDX-License-Identifier: MIT
"""Pages of the command line, made from the commands themselves: one a command, with all of its options."""

import dataclasses
import re
from typing import Any, get_args

import typer

from pinwm_drake.cli.app import app
from pinwm_drake.request import Group, RequestField, request_fields
from pinwm_drake.validation import bounds, unit_of, words

FOLDER = "reference/cli/"
_HEAD = ["option", "values", "unit", "default", "does"]
_GROUPS = ("Arguments", *get_args(Group))  # the order of the help


def commands() -> dict[str, Any]:
    """Return every command by its name, such as "capture import colmap", in the order of the help."""
    found: dict[str, Any] = {}
    for name, lazy in typer.main.get_command(app).commands.items():  # type: ignore[attr-defined]
        _collect(name, lazy.callback(), found)
    return found


def _collect(name: str, command: Any, found: dict[str, Any]) -> None:
    found[name] = command
    for inner, part in getattr(command, "commands", {}).items():
        _collect(f"{name} {inner}", part, found)


def cli_pages() -> dict[str, str]:
    """Return the Markdown of every page of the command line by its path in the site."""
    known = commands()
    pages = {f"{FOLDER}index.md": _index(known)}
    for name in known:
        if " " not in name:
            parts = [one for one in known if one == name or one.startswith(f"{name} ")]
            pages[f"{FOLDER}{name}.md"] = "\n".join(line for one in parts for line in _section(one, known[one]))
    return pages


def _index(known: dict[str, Any]) -> str:
    rows = []
    for name, command in known.items():
        page = f"{name.split()[0]}.md"
        anchor = f"#pinwm-{name.replace(' ', '-')}" if " " in name else ""
        rows.append(f"| [`pinwm {name}`]({page}{anchor}) | {_cell(_summary(command))} |")
    lines = [
        "# Commands",
        "",
        "These pages list every command of `pinwm` and every option. They are made from the commands themselves.",
        "`pinwm COMMAND --help` shows the same in a terminal.",
        "",
        "Each option is a field of a request as well: the Python call of a command takes the same names and ranges.",
        "",
        "| command | does |",
        "| --- | --- |",
        *rows,
        "",
        "Exit codes stand in [Reliability](../reliability.md#exit-codes).",
        "",
    ]
    return "\n".join(lines)


def _section(name: str, command: Any) -> list[str]:
    lines = [f"{'##' if ' ' in name else '#'} pinwm {name}", "", _text(command.help), ""]
    if getattr(command, "commands", None) and not command.invoke_without_command:
        return lines
    usage = " ".join(one.metavar or one.name.upper() for one in command.params if one.param_type_name == "argument")
    lines += ["```text", f"pinwm {name} [OPTIONS] {usage}".rstrip(), "```", ""]
    if command.epilog:
        lines += [command.epilog.replace("Example: ", "Example: `", 1).replace("; then: ", "`; then: `") + "`.", ""]
    for group, rows in _rows(command).items():
        lines += [f"**{group}**", "", *_table(group, rows), ""]
    return lines


def _table(group: str, rows: list[list[str]]) -> list[str]:
    """Return a table without the columns that are empty."""
    head = ["argument" if group == "Arguments" else "option", *_HEAD[1:]]
    kept = [k for k in range(len(head)) if any(row[k] for row in rows)]
    return ["| " + " | ".join(row[k] for k in kept) + " |" for row in (head, ["---"] * len(head), *rows)]


def _rows(command: Any) -> dict[str, list[list[str]]]:
    """Return the rows of the tables of a command's options, by group."""
    request = getattr(command.callback, "request", None)
    fields = {field.name: field for field in request_fields(request)} if request is not None else {}
    found: dict[str, list[list[str]]] = {}
    for parameter in command.params:
        field = fields.get(parameter.name)
        if parameter.hidden or parameter.name == "help":
            continue
        group = (parameter.rich_help_panel or "Options") if field is None or not field.shown.argument else "Arguments"
        cells = _plain_cells(parameter) if field is None else _cells(field)
        found.setdefault(group, []).append([_names(parameter), *map(_cell, cells)])
    return {group: found[group] for group in sorted(found, key=lambda one: _order(one))}


def _order(group: str) -> int:
    return _GROUPS.index(group) if group in _GROUPS else len(_GROUPS)


def _names(parameter: Any) -> str:
    if parameter.param_type_name == "argument":
        return f"`{parameter.metavar or parameter.name.upper()}`"
    return ", ".join(f"`{name}`" for name in (*parameter.opts, *parameter.secondary_opts))


def _cells(field: RequestField) -> list[str]:
    """Return values, unit, default and help of a field of a request."""
    unit = unit_of(field.info)
    allowed = bounds(field.info) or words(field.kind, field.info).removesuffix(f" {unit}")
    if field.shown.argument:
        allowed = ""
    elif allowed.startswith("a list of "):
        allowed = allowed.removeprefix("a list of ").removesuffix("s") + ", again for each"
    return [
        allowed.replace("true, false", "flag").replace(", null", ""),
        "" if unit == "1" else unit,
        _default(field),
        str(field.info.description),
    ]


def _default(field: RequestField) -> str:
    if field.shown.default:
        return field.shown.default
    value = field.default
    if value is dataclasses.MISSING:
        return "" if field.shown.argument else "required"
    if isinstance(value, bool):
        return "on" if value else "off"
    if value is None or value == ():
        return "none"
    return " ".join(map(str, value)) if isinstance(value, tuple) else str(value)


def _plain_cells(parameter: Any) -> list[str]:
    """Return the cells of an option that is no field of a request."""
    shown = parameter.show_default if isinstance(parameter.show_default, str) else ""
    kind = "flag" if getattr(parameter, "is_flag", False) else (parameter.metavar or "path").lower()
    return [kind, "", shown or "none", str(parameter.help)]


def _summary(command: Any) -> str:
    return _text(command.help).partition("\n")[0]


def _text(markup: str | None) -> str:
    """Return a help text without rich's escapes."""
    return re.sub(r"\\(?=\[)", "", (markup or "").strip())


def _cell(text: str) -> str:
    return " ".join(_text(text).replace("|", "\\|").replace("*", "\\*").split())
