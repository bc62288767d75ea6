# SPDX-License-Identifier: MIT
"""Plain data of JSON and YAML, of limited size and depth."""

import json
import math
import re
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, NoReturn

import yaml

from pinwm_drake.errors import InputError
from pinwm_drake.reading.contents import as_text, guarded

MOST_JSON, MOST_YAML = 2**25, 2**19  # bytes; PyYAML takes some 10 s for a megabyte
DEEPEST = 64  # levels of lists and mappings in each other
MOST_VALUES = 1_000_000  # with those that aliases stand for, each time that they do
# Tag, pattern and first characters of numbers such as 1e-3, which YAML 1.1 takes for text.
YAML_FLOAT = "tag:yaml.org,2002:float", re.compile(r"[-+]?(\d+\.?\d*|\.\d+)[eE][-+]?\d+$"), list("-+.0123456789")


class _Loader(yaml.SafeLoader):  # type: ignore[misc]  # PyYAML has no types
    """Plain YAML data of limited depth; numbers such as 1e-3 are numbers."""

    def fetch_flow_collection_start(self, kind: Any) -> None:
        """Begin a list or mapping in brackets; PyYAML looks at all that are open for each token."""
        if self.flow_level > DEEPEST:
            raise RecursionError
        super().fetch_flow_collection_start(kind)

    def add_indent(self, column: int) -> bool:
        """Begin a list or mapping by its indentation."""
        if len(self.indents) > 2 * DEEPEST:
            raise RecursionError
        deeper: bool = super().add_indent(column)
        return deeper


_Loader.add_implicit_resolver(*YAML_FLOAT)


class YamlDumper(yaml.SafeDumper):  # type: ignore[misc]  # PyYAML has no types
    """Plain data; a text that `parse_yaml` would take for a number, such as 1e3, or that has lines, is quoted."""

    def ignore_aliases(self, data: Any) -> bool:
        """Flag, always true: YAML's anchors are never written."""
        return True


def _text_node(dumper: YamlDumper, text: str) -> Any:
    """Node of a text; PyYAML does not read all that has lines as it writes it, but in double quotes."""
    return dumper.represent_scalar("tag:yaml.org,2002:str", text, None if text.isprintable() else '"')


YamlDumper.add_implicit_resolver(*YAML_FLOAT)
YamlDumper.add_representer(str, _text_node)


def parse_json(content: bytes | str, path: Path, *, not_finite: Callable[[str], Any] | None = None) -> Any:
    """Return the value of a JSON text.

    Args:
        content: The text.
        path: Path that messages name.
        not_finite: What becomes of NaN and infinite numbers, called with their texts; None for numbers as they are.

    Raises:
        InputError: It is no JSON, too long, or too deep; the message names the line.
    """
    text = _short(content, path, MOST_JSON)

    number = None if not_finite is None else partial(_number, not_finite)
    with guarded(path, "JSON"):
        _check_brackets(text, path)
        try:
            return json.loads(text, parse_constant=not_finite, parse_float=number)
        except json.JSONDecodeError as error:
            raise InputError(path, row=error.lineno, value=error.msg, allowed="JSON") from error


def _number(not_finite: Callable[[str], Any], digits: str) -> Any:
    """Number of its digits, or what becomes of one that is not finite."""
    return found if math.isfinite(found := float(digits)) else not_finite(digits)


def no_infinite(path: Path) -> Callable[[str], NoReturn]:
    """Return a function for `parse_json` that refuses NaN and infinite numbers of a file."""

    def refused(digits: str) -> NoReturn:
        raise InputError(path, value=digits, allowed="finite numbers")

    return refused


def check_finite(value: Any, path: Path) -> None:
    """Raise InputError where plain data of a file holds NaN or an infinite number."""
    try:
        json.dumps(value, default=str, allow_nan=False)
    except ValueError as error:
        raise InputError(path, value="NaN or an infinite number", allowed="finite numbers") from error


def parse_yaml(content: bytes | str, path: Path) -> Any:
    """Return the value of a YAML text of plain data, one document.

    Args:
        content: The text.
        path: Path that messages name.

    Raises:
        InputError: It is no YAML, too long, too deep, or its aliases stand for too much; the message names the line.
    """
    text = _short(content, path, MOST_YAML)
    with guarded(path, "YAML"):
        loader = _Loader(text)
        try:
            node = loader.get_single_node()
            if node is None:
                return None
            _check_nodes(node, path)
            return loader.construct_document(node)
        except yaml.YAMLError as error:
            mark = getattr(error, "problem_mark", None)
            problem = getattr(error, "problem", None) or str(error)
            raise InputError(path, row=mark.line + 1 if mark else None, value=problem, allowed="YAML") from error
        except RecursionError as error:
            raise _too_deep(path, "YAML") from error
        finally:
            loader.dispose()


def _short(content: bytes | str, path: Path, most: int) -> str:
    if len(content) > most:
        raise InputError(path, value=f"{len(content)} bytes", allowed=f"{most} bytes at most")
    return as_text(content, path) if isinstance(content, bytes) else content


_TOKENS = re.compile(r'"[^"\\]*(?:\\.[^"\\]*)*"|[\[{]|[\]}]', re.DOTALL)


def _check_brackets(text: str, path: Path) -> None:
    """Raise InputError where brackets of a JSON text are too deep in each other, before it is parsed."""
    depth = 0
    for found in _TOKENS.finditer(text):
        first = found[0][0]
        depth += (first in "[{") - (first in "]}")
        if depth > DEEPEST:
            raise _too_deep(path, "JSON")


def _check_nodes(root: Any, path: Path) -> None:
    """Raise InputError where a graph of YAML nodes is too deep or, as a tree, too large."""
    known: dict[int, tuple[int, int]] = {}

    def measure(node: Any, depth: int) -> tuple[int, int]:
        """Number of values, and of levels below."""
        if depth > DEEPEST:  # an alias within what it stands for comes here too
            raise _too_deep(path, "YAML")
        if isinstance(node, yaml.ScalarNode):
            return 1, 0
        if id(node) not in known:
            mapping = isinstance(node, yaml.MappingNode)
            inner = [one for pair in node.value for one in pair] if mapping else node.value
            found = [measure(one, depth + 1) for one in inner]
            known[id(node)] = 1 + sum(one[0] for one in found), 1 + max((one[1] for one in found), default=0)
        if depth + known[id(node)][1] > DEEPEST:
            raise _too_deep(path, "YAML")
        return known[id(node)]

    if (number := measure(root, 0)[0]) > MOST_VALUES:
        raise InputError(path, value=f"{number} values, with aliases", allowed=f"{MOST_VALUES} at most")


def _too_deep(path: Path, what: str) -> InputError:
    return InputError(path, value=f"more than {DEEPEST} levels", allowed=f"{what} of {DEEPEST} levels at most")
