# SPDX-License-Identifier: MIT
"""Values of a YAML file that are changed in its text, so that comments and order stay."""

import os
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import yaml

from pinwm_drake.documents import Entry, yaml_text
from pinwm_drake.errors import PinwmError
from pinwm_drake.files import replacing
from pinwm_drake.reading.contents import read_text
from pinwm_drake.reading.trees import MOST_YAML, parse_yaml


def amend(path: Path, values: Mapping[tuple[str, ...], Any]) -> list[str]:
    """Put values into a YAML file, by their keys from the outermost on.

    The text is changed and read again. Where that gives something else, as with anchors, the file is written anew.

    Args:
        path: The file, which holds a mapping or nothing, or is missing.
        values: Plain values; a mapping takes the place of what is there.

    Returns:
        A line that begins with "doubtful: " where comments are gone, or else none.

    Raises:
        InputError: The file cannot be read or written, or an entry with keys below it is no mapping.
    """
    text = read_text(path, MOST_YAML) if os.path.lexists(path) else ""
    wanted = _mapping(Entry(path, "", parse_yaml(text, path)))
    for keys, value in values.items():
        _put(Entry(path, "", wanted), keys, value)
    changed = text
    with suppress(yaml.YAMLError, PinwmError):  # an intermediate text is none
        for keys, value in values.items():
            changed = _changed(changed, keys, value)
    if not text.strip() or _parsed(changed, path) != wanted:
        changed = yaml_text(wanted)
    with replacing(path) as temporary:
        temporary.write_text(changed, encoding="utf-8")
    return [f"doubtful: comments of {path.name} are gone"] if _comments(text) - _comments(changed) else []


def _comments(text: str) -> Counter[str]:
    """Comments of a YAML text: they are between its tokens, or in the first line of a block of text."""
    found, end = list[str](), 0
    for token in yaml.scan(text, Loader=yaml.SafeLoader):
        found += re.findall("#.*", text[end : token.start_mark.index])
        end = max(end, token.end_mark.index)
        if isinstance(token, yaml.ScalarToken) and token.style in ("|", ">"):
            found += re.findall("#.*", text[token.start_mark.index : end].partition("\n")[0])
    return Counter(found)


def _mapping(entry: Entry) -> dict[Any, Any]:
    """Copy of an entry that is a mapping, or nothing."""
    if not isinstance(entry.value, dict | None):
        raise entry.refusal("a mapping with keys")
    return dict(entry.value or {})


def _put(document: Entry, keys: Sequence[str], value: Any) -> None:
    here = document
    for key in keys[:-1]:
        below = _mapping(Entry(here.path, f"{here.place}.{key}".lstrip("."), here.value.get(key)))
        here.value[key] = below
        here = Entry(here.path, f"{here.place}.{key}".lstrip("."), below)
    here.value[keys[-1]] = value


def _parsed(text: str, path: Path) -> Any:
    try:
        return parse_yaml(text, path)
    except PinwmError:  # what the change made is no YAML: it is not used
        return None


def _changed(text: str, keys: Sequence[str], value: Any) -> str:
    """Text of a YAML document with a value put in."""
    node, depth, start = yaml.compose(text, Loader=yaml.SafeLoader), 0, 0
    while isinstance(node, yaml.MappingNode) and depth < len(keys):
        found = next((pair for pair in node.value if pair[0].value == keys[depth]), None)
        if found is None:
            return _inserted(text, node, keys[depth:], value)
        node, depth, start = found[1], depth + 1, found[0].end_mark.index
    if node is None:
        return f"{text.rstrip()}\n{_written(_nested(keys, value))[1:-1]}\n".lstrip()
    below = {key.value for key, _ in node.value} if isinstance(node, yaml.MappingNode) else None
    if isinstance(value, dict) and below == value.keys():
        for key, one in value.items():
            text = _changed(text, [*keys, key], one)
        return text
    return f"{text[:start]}: {_written(_nested(keys[depth:], value))}{text[max(_end(node), start + 1) :]}"


def _inserted(text: str, node: Any, keys: Sequence[str], value: Any) -> str:
    """Text with a new key at the end of a mapping in brackets, or else before the first key of a mapping."""
    entry = _written(_nested(keys, value))[1:-1]
    if node.flow_style:
        at = node.end_mark.index - 1
        before = text[:at].rstrip().rstrip(",")
        return f"{before}{', ' if node.value else ''}{entry}{text[at:]}"
    last = node.value[-1][0].start_mark
    return f"{text[: last.index]}{entry}\n{' ' * last.column}{text[last.index :]}"


def _nested(keys: Sequence[str], value: Any) -> Any:
    for key in reversed(keys):
        value = {key: value}
    return value


def _written(value: Any) -> str:
    """Text of a value on one line, in brackets where it is a mapping or list."""
    text = yaml.safe_dump(value, sort_keys=False, default_flow_style=True, allow_unicode=True, width=10**6)
    return text.removesuffix("\n").removesuffix("\n...")


def _end(node: Any) -> int:
    """Place behind a value; what PyYAML has as the end of a block is the next token, behind comments."""
    if isinstance(node, yaml.ScalarNode) or node.flow_style or not node.value:
        return int(node.end_mark.index)
    last = node.value[-1]
    return _end(last[1] if isinstance(last, tuple) else last)
