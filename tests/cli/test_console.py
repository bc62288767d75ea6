# SPDX-License-Identifier: MIT
import io
import math
import sys
import time
import warnings

import pytest

from pinwm_drake.cli import console
from pinwm_drake.cli.console import duration, quiet, stages_bar, take_any_terminal


@pytest.fixture
def clock(monkeypatch):
    """Time that passes as the test says; the thread that looks at it is asleep."""
    now = [100.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    monkeypatch.setattr(console, "_LOOK", 1e6)
    return now


def test_a_duration_is_hours_minutes_and_seconds():
    assert [duration(seconds) for seconds in (0.0, 59.6, 3661.0, 360000.0)] == [
        *("0:00:00", "0:01:00", "1:01:01", "100:00:00"),
    ]
    assert duration(math.nan) == duration(math.inf) == "-:--:--"


def test_without_a_terminal_a_stage_has_lines_at_intervals_and_one_at_its_end(capsys, clock):
    with stages_bar() as show:
        assert capsys.readouterr() == ("", "")
        show("fitting", 0.0, "getting ready")
        clock[0] += 4.0
        show("fitting", 0.1, "loss 2")
        assert capsys.readouterr().out == ""
        clock[0] += 4.0
        show("fitting", 0.2, "[1, 2]")
        assert capsys.readouterr().out == "fitting  20%  [1, 2]  0:00:32 left\n"
        clock[0] += 9.0
        show("fitting", 0.5, "loss 1")
        clock[0] += 1.0
        show("fitting", 0.6, "loss 1", 30.0)
        assert capsys.readouterr().out == "fitting  60%  loss 1  0:00:30 left\n"
        show("fitting", 1.0, "loss 0")
        show("fitting", 1.0, "loss 0")
        assert capsys.readouterr().out == "fitting 100%  loss 0  0:00:18 taken\n"
        show("drawing", 0.5, "", tell=True)
        assert capsys.readouterr().out == "drawing  50%  -:--:-- left\n"


def test_work_that_goes_on_from_a_share_is_as_fast_as_what_was_done_since(capsys, clock):
    with stages_bar() as show:
        show("evaluating", 0.5, "")
        clock[0] += 60.0
        show("evaluating", 0.75, "")
        assert capsys.readouterr().out == "evaluating  75%  -:--:-- left\n"
        clock[0] += 40.0
        show("evaluating", 0.875, "")
    assert capsys.readouterr().out == "evaluating  88%  0:00:40 left\n"


def test_the_time_left_of_work_that_compiles_first_is_not_shown(capsys, clock):
    with stages_bar() as show:
        show("identifying", 0.0, "")
        clock[0] += 300.0  # compiles
        show("identifying", 0.1, "")
        assert capsys.readouterr().out == "identifying  10%  -:--:-- left\n"
        clock[0] += 20.0
        show("identifying", 0.2, "", tell=True)
        assert capsys.readouterr().out == "identifying  20%  0:02:40 left\n"


def test_between_reports_the_time_left_falls_and_then_is_unknown(capsys, clock):
    lines = console._Lines(ends=True)
    try:
        for done in (0.0, 0.25, 0.5):
            clock[0] += 2.0
            lines.show("identifying", done, "", tell=True)
        for wait in (1.0, 2.0, 30.0):  # the thread prints then
            clock[0] += wait
            lines._print(clock[0])
    finally:
        lines.close()
    left = [line.split()[2] for line in capsys.readouterr().out.splitlines()]
    # 0.25 in 2 s, so that 0.5 take 4 s.
    assert left == ["-:--:--", "-:--:--", "0:00:04", "0:00:03", "0:00:01", "-:--:--"]


def test_a_stage_that_does_not_report_is_seen_to_go_on(capsys, monkeypatch):
    monkeypatch.setattr(console, "_FIRST", 0.0)
    monkeypatch.setattr(console, "_LOOK", 0.01)
    with stages_bar(transient=True) as show:
        show("identifying", 0.0, "getting ready")
        deadline = time.monotonic() + 60.0
        output = ""
        while output.count("getting ready") < 1 and time.monotonic() < deadline:
            output += capsys.readouterr().out
    assert output.startswith("identifying   0%  getting ready")


def test_the_end_of_a_bar_that_goes_has_no_line(capsys):
    with stages_bar(transient=True) as show:
        show("drawing", 1.0, "")
    assert capsys.readouterr() == ("", "")


def test_on_a_terminal_there_is_a_bar_for_each_stage(capsys, monkeypatch):
    monkeypatch.setenv("TTY_COMPATIBLE", "1")
    monkeypatch.setenv("TTY_INTERACTIVE", "1")
    monkeypatch.setenv("COLUMNS", "120")
    with stages_bar():
        pass
    assert capsys.readouterr().out == ""
    with stages_bar() as show:
        show("fitting", 0.5, "[1, 2]")
        show("drawing", 1.0, "", 3.0)
    output = capsys.readouterr().out
    assert "fitting" in output
    assert "50 %  [1, 2]" in output
    assert "drawing" in output
    assert "0:00:03 left" in output


def test_warnings_of_others_are_silent_and_ours_take_a_line(capsys):
    with quiet():
        warnings.warn("deprecated", DeprecationWarning, stacklevel=1)
        assert capsys.readouterr() == ("", "")
        warnings.warn_explicit("no effect", FutureWarning, str(console.__file__), 1)
    assert capsys.readouterr() == ("", "warning: no effect\n")


@pytest.mark.parametrize(
    ("coding", "spelled"),
    [
        ("ascii", "friction mu 0.2 +-5 deg, m/s2 -> 3 x e ?"),
        ("latin-1", "friction mu 0.2 ±5°, m/s² -> 3 × é ?"),
        ("utf-8", "friction μ 0.2 ±5°, m/s² → 3 × é 🦆"),
    ],
)
def test_signs_that_a_terminal_lacks_are_spelled(monkeypatch, coding, spelled):
    output, errors = io.BytesIO(), io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(output, coding, write_through=True))
    monkeypatch.setattr(sys, "stderr", io.TextIOWrapper(errors, coding, write_through=True))
    take_any_terminal()
    console.say("friction μ 0.2 ±5°, m/s² → 3 × é 🦆")
    console.warn("μ")
    assert output.getvalue() == f"{spelled}\n".encode(coding)
    assert errors.getvalue().decode(coding) == ("warning: μ\n" if coding == "utf-8" else "warning: mu\n")
