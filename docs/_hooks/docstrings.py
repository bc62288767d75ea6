# SPDX-License-Identifier: MIT
"""Extension of griffe for this project's docstrings.

An entry for several names becomes one for each, so that each has its type. The comment behind a constant is its
docstring.
"""

import io
import re
import tokenize
from typing import Any

import griffe

_SECTION = re.compile(r"^(Args|Attributes):\n((?:(?: +.*)?\n)*)", re.MULTILINE)
_ENTRY = re.compile(r"^    (\w+(?:, \w+)+):((?:.*\n)(?:(?: {5,}.*)?\n)*)", re.MULTILINE)


def separated(docstring: str) -> str:
    """Return a docstring in which "a, b: text" is "a: text" and "b: text", in its sections Args and Attributes."""

    def each(entry: re.Match[str]) -> str:
        return "".join(f"    {name.strip()}:{entry[2].rstrip()}\n" for name in entry[1].split(",")) + "\n"

    def section(found: re.Match[str]) -> str:
        return f"{found[1]}:\n{_ENTRY.sub(each, found[2])}"

    return _SECTION.sub(section, docstring + "\n").rstrip("\n")


def comment_of(lines: list[str]) -> str:
    """Return the comment at the end of a statement's lines; empty where there is none."""
    readline = io.StringIO("\n".join(lines)).readline
    try:
        found = [token.string for token in tokenize.generate_tokens(readline) if token.type == tokenize.COMMENT]
    except (tokenize.TokenError, IndentationError):
        return ""
    return " ".join(comment.lstrip("# ") for comment in found if not re.match(r"# *(type: ignore|noqa)", comment))


class Docstrings(griffe.Extension):
    """Extension that separates entries of docstrings, and gives docstrings to constants."""

    def on_instance(self, *, obj: griffe.Object, **kwargs: Any) -> None:
        """Change the docstring of an object that was loaded."""
        if obj.docstring is not None:
            obj.docstring.value = separated(obj.docstring.value)
        elif obj.is_attribute and obj.parent is not None and obj.parent.is_module and not obj.name.startswith("_"):
            # An empty one is enough for the constant to be shown.
            obj.docstring = griffe.Docstring(comment_of(obj.lines), parent=obj)
