# SPDX-License-Identifier: MIT
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.docs.pages import PAGES, ROOT, content, name_of

SHELL = ("bash", "sh", "shell", "console")
REASONS = ("long", "hardware")  # for which no test runs a snippet
SNIPPETS = {page: content(page.read_text(encoding="utf-8")).snippets for page in PAGES}
MARKED = [
    (page, one) for page, found in SNIPPETS.items() for one in found if one.language in ("python", *SHELL) and one.mark
]
RUN = [
    page
    for page, found in SNIPPETS.items()
    if any(one.language in ("python", *SHELL) and not one.mark for one in found)
]


def run(arguments: list[str], folder: Path) -> None:
    """Run a program in an empty folder, with this Python's programs on the path."""
    environment = {
        **os.environ,
        "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}",
        "PYTHONPATH": str(ROOT),
    }
    done = subprocess.run(arguments, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize(
    ("page", "snippet"), MARKED, ids=lambda one: name_of(one) if isinstance(one, Path) else one.line
)
def test_a_mark_says_why_or_where_a_snippet_runs(page, snippet):
    if snippet.mark in REASONS:
        return
    test = ROOT / snippet.mark
    allowed = f"{', '.join(REASONS)}, or the path of a test that reads the page"
    assert test.is_file(), f"got {snippet.mark}; allowed: {allowed}"
    assert page.name in test.read_text(encoding="utf-8"), f"{snippet.mark} does not name {page.name}"


@pytest.mark.parametrize("page", RUN, ids=name_of)
def test_snippets_without_a_mark_run(page, tmp_path):
    """Those of Python one after another in one process, those of the shell one by one."""
    unmarked = [one for one in SNIPPETS[page] if not one.mark]
    if code := "\n".join(one.text for one in unmarked if one.language == "python"):
        (tmp_path / "snippets.py").write_text(code, encoding="utf-8")
        run([sys.executable, "snippets.py"], tmp_path)
    for one in unmarked:
        if one.language in SHELL:
            run(["bash", "-euo", "pipefail", "-c", one.text], tmp_path)


def test_marks_are_read():
    text = "<!-- snippet: long -->\n```bash\nmake demo\n```\n\n```python\nx = 1\n```\n\n"
    text += "<!-- snippet: hardware -->\n\n    $ a\n"
    assert [(one.language, one.mark, one.text) for one in content(text).snippets] == [
        ("bash", "long", "make demo\n"),
        ("python", "", "x = 1\n"),
        ("", "hardware", "$ a\n"),
    ]
