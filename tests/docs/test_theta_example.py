# SPDX-License-Identifier: MIT
"""The example of docs/explanation/physics.md, which steps a twin with gradients to θ."""

import re
from pathlib import Path

import pytest

PAGE = Path(__file__).resolve().parents[2] / "docs/explanation/physics.md"


def test_it_finds_the_friction_of_the_measurement_and_prints_what_the_page_says(capsys):
    code = re.search(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)[1]
    names: dict = {}
    exec(compile(code, PAGE.name, "exec"), names)
    assert float(names["log_mu"].detach().exp()) == pytest.approx(0.05, rel=1e-6)
    # A central difference at the solution is the derivative that the page prints, to its second order: 1e-4.
    log_mu, h = names["log_mu"].detach(), 1e-3
    difference = float(names["way"](log_mu + h) - names["way"](log_mu - h)) / (2 * h)
    assert float(names["slope"]) == pytest.approx(difference, rel=2e-3)
    printed = capsys.readouterr().out.splitlines()
    assert len(printed) == 6
    assert "\n".join(printed) in PAGE.read_text(encoding="utf-8")
