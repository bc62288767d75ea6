# SPDX-License-Identifier: MIT
import math

from pinwm_drake.cli.console import duration, stages_bar


def test_a_duration_is_hours_minutes_and_seconds():
    assert [duration(seconds) for seconds in (0.0, 59.6, 3661.0, 360000.0)] == [
        *("0:00:00", "0:01:00", "1:01:01", "100:00:00"),
    ]
    assert duration(math.nan) == duration(math.inf) == "-:--:--"


def test_a_bar_without_a_stage_prints_nothing(capsys):
    with stages_bar():
        pass
    assert capsys.readouterr() == ("", "")
    with stages_bar() as show:
        show("fitting", 0.5, "[1, 2]")
        show("drawing", 1.0, "")
    output = capsys.readouterr().out
    assert "fitting" in output
    assert "50 %" in output
    assert "drawing" in output


def test_a_bar_that_goes_prints_nothing_where_there_is_no_terminal(capsys):
    with stages_bar(transient=True) as show:
        show("drawing", 1.0, "")
    assert capsys.readouterr() == ("", "")
