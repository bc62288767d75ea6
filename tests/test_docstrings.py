# SPDX-License-Identifier: MIT
import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
FOLDERS = ("pinwm_drake", "models", "systems")
# A first line that opens with one of these leans on the name beside it, or on a neighbour.
OPENERS = (
    "what how where whether which who whose when why of with without as in for from to by at on "
    "that those this these there here it its they and but or see"
)
FEWEST_WORDS = 3


def first_lines(text: str) -> Iterator[tuple[int, str]]:
    """The number of the line and the first line of every docstring in a module."""
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)):
            docstring = ast.get_docstring(node)
            if docstring is not None:
                yield node.body[0].lineno, docstring.partition("\n")[0]


def fault(line: str) -> str | None:
    """The reason for which a docstring's first line does not stand alone, or None."""
    words = line.split()
    if len(words) < FEWEST_WORDS:
        return f"fewer than {FEWEST_WORDS} words"
    if words[0].strip(",:;.").lower() in OPENERS.split():
        return f"opens with {words[0]!r}"
    if words[0][0] in "([":
        return "opens with a shape"
    if [word.strip(",:;.").lower() for word in words[:2]] == ["the", "same"]:
        return "opens with 'The same'"
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
            for number, line in first_lines(path.read_text(encoding="utf-8")):
                reason = fault(line)
                if reason is not None:
                    found.append(f"{file}:{number}: {reason}: {line}")
    return found


def test_first_lines_stand_alone():
    assert offences(ROOT) == []
    assert len(list((ROOT / "pinwm_drake").rglob("*.py"))) > 10


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        ("What there is in a folder.", "opens with 'What'"),
        ("Of the round to come.", "opens with 'Of'"),
        ("Whether, at rest, it moves.", "opens with 'Whether,'"),
        ("(n, 3), the image's colours.", "opens with a shape"),
        ("The same numbers without a graph.", "opens with 'The same'"),
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
    (tmp_path / "systems/view/a.py").write_text(text % "What is seen.\n\n        More.\n        ")
    assert offences(tmp_path) == ["systems/view/a.py:8: opens with 'What': What is seen."]
