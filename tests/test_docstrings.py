# SPDX-License-Identifier: MIT
import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
FOLDERS = ("pinwm_drake", "models", "systems")
FEWEST_WORDS, MOST_WORDS = 3, 25
SECTIONS = ("Args", "Attributes", "Raises", "Returns", "Source", "Yields")


def docstrings(text: str) -> Iterator[tuple[int, str]]:
    """Return the number of the line and the text of every docstring in a module."""
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)):
            docstring = ast.get_docstring(node)
            if docstring is not None:
                yield node.body[0].lineno, docstring


def fault(line: str) -> str | None:
    """The reason for which a docstring's first line does not stand alone, or None."""
    words = line.split()
    if len(words) < FEWEST_WORDS:
        return f"fewer than {FEWEST_WORDS} words"
    plain = sum(len(word.strip(",:;.()[]")) > 1 for word in words)  # symbols of a formula are none
    if plain > MOST_WORDS:
        return f"{plain} words; allowed: {MOST_WORDS}"
    if words[0][0] in "([":
        return "opens with a shape"
    if not line.endswith("."):
        return "does not end with a period"
    return None


def offences(root: Path) -> list[str]:
    """Every first line with a fault, as `file:line: reason: text`."""
    found = []
    for folder in FOLDERS:
        for path in sorted((root / folder).rglob("*.py")):
            file = path.relative_to(root).as_posix()
            # pinwm_drake holds links to the other two folders.
            if path.resolve() != path.absolute():
                continue
            for number, text in docstrings(path.read_text(encoding="utf-8")):
                line = text.partition("\n")[0]
                reason = fault(line)
                if reason is not None:
                    found.append(f"{file}:{number}: {reason}: {line}")
                headings = re.findall(r"^(\w+):$", text, re.MULTILINE)
                if unknown := [heading for heading in headings if heading not in SECTIONS]:
                    found.append(f"{file}:{number}: sections {unknown}; allowed: {SECTIONS}")
    return found


def test_first_lines_stand_alone():
    assert offences(ROOT) == []
    assert len(list((ROOT / "pinwm_drake").rglob("*.py"))) > 10


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        ("(n, 3), the image's colours.", "opens with a shape"),
        ("Number " * 26 + ".", "26 words; allowed: 25"),
        ("Draws it.", "fewer than 3 words"),
        ("Number of the next round", "does not end with a period"),
        ("Number of the next round.", None),
        ("Share of successful episodes, 0 to 1.", None),
        ("Flag: the object is at rest.", None),
    ],
)
def test_a_first_line_is_judged(line, reason):
    assert fault(line) == reason


def test_a_bad_docstring_is_found(tmp_path):
    (tmp_path / "systems/view").mkdir(parents=True)
    text = '"""Views of a scene."""\n\n\nclass A:\n    """View of one body."""\n\n    def f(self):\n        """%s"""\n'
    (tmp_path / "systems/view/a.py").write_text(text % "Body that is seen.")
    assert offences(tmp_path) == []
    (tmp_path / "systems/view/a.py").write_text(text % "Seen.\n\n        More.\n        ")
    assert offences(tmp_path) == ["systems/view/a.py:8: fewer than 3 words: Seen."]
