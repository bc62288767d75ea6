# SPDX-License-Identifier: MIT
"""Messages that docs/how-to/troubleshooting.md quotes are ones that the code has."""

import ast
import re
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs/how-to/troubleshooting.md"
# What other programs say, and what a table or a file has.
OTHERS = re.compile(
    r"^arm\(\)$|lib(EGL|GL)\.so|^pydrake$|^module |^identifiable|^(disarmed|grip|view|start)$|^\.NAME|^crosscheck$"
)


def quoted() -> list[str]:
    """Messages of the first column of the tables of symptoms, in backticks."""
    rows = [line for line in PAGE.read_text(encoding="utf-8").splitlines() if line.count("|") == 4]
    found = [text for row in rows for text in re.findall(r"`([^`]+)`", row.split("|")[1])]
    return [text for text in found if not OTHERS.search(text) and not text.startswith("--")]


@cache
def texts() -> str:
    """Return all texts of the sources, those that are joined from parts with a gap for each value."""
    parts = []
    for folder in ("pinwm_drake", "systems"):
        for path in sorted((ROOT / folder).rglob("*.py")):
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                if isinstance(node, ast.JoinedStr):
                    parts.append(
                        "".join(part.value if isinstance(part, ast.Constant) else "\0" for part in node.values)
                    )
                elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                    parts.append(node.value)
    return "\n".join(parts).replace("`", "").lower()


def test_there_are_messages():
    assert len(quoted()) > 40


@pytest.mark.parametrize("message", quoted())
def test_a_message_is_one_of_the_code(message):
    parts = [re.escape(part.strip().lower()) for part in message.split("...")]
    assert re.search(r"[^\n]*?".join(parts), texts())
