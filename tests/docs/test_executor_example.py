# SPDX-License-Identifier: MIT
"""The example of docs/how-to/many-machines.md, which shares predictions among processes."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from pinwm_drake.models import capture_path

PAGE = Path(__file__).resolve().parents[2] / "docs/how-to/many-machines.md"


@pytest.mark.nightly
def test_it_prints_what_the_page_says(tmp_path):
    text = PAGE.read_text(encoding="utf-8")
    code, printed = re.search(r"```python\n(.*?)```\n\n```text\n(.*?)```", text, re.DOTALL).groups()
    (tmp_path / "share.py").write_text(code, encoding="utf-8")
    environment = {**os.environ, "PYTHONPATH": str(PAGE.parents[2])}
    command = [sys.executable, str(tmp_path / "share.py")]
    done = subprocess.run(command, check=True, env=environment, capture_output=True, text=True)
    assert done.stdout == printed
    assert len(printed.splitlines()) == len(list((capture_path("t_block") / "episodes").iterdir()))
