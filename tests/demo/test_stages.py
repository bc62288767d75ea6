# SPDX-License-Identifier: MIT
import io
import re

import pytest
from rich.console import Console

from pinwm_drake.demo.stages import Stages


def run(terminal: bool) -> tuple[str, Stages]:
    output = io.StringIO()
    stages = Stages(Console(file=output, force_terminal=terminal, width=120))
    with stages.stage("align") as report:
        for share in (0.1, 0.3, 0.4, 0.6, 1.0):
            report(share, f"loss {share}")
    return output.getvalue(), stages


def test_a_pipe_gets_a_line_for_each_quarter():
    output, stages = run(terminal=False)
    lines = output.splitlines()
    assert lines[:3] == ["align ...", "  30 %  loss 0.3", "  60 %  loss 0.6"]
    assert re.fullmatch(r"align: \d+\.\d s", lines[3])
    assert len(lines) == 4
    assert [cost.name for cost in stages.costs] == ["align"]


def test_a_terminal_gets_a_bar_and_one_line_that_stays():
    output, _ = run(terminal=True)
    assert "loss 1.0" in output
    assert "..." not in output


def test_a_stage_that_fails_costs_nothing_and_its_error_goes_on():
    stages = Stages(Console(file=io.StringIO()))
    with pytest.raises(ValueError, match="wrong"), stages.stage("align"):
        raise ValueError("wrong")
    assert stages.costs == []
