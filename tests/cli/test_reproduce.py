# SPDX-License-Identifier: MIT
import json
from pathlib import Path

import pytest

from pinwm_drake.paper.reproduce.request import ReproduceRun

OPTIONS = ["--task", "push", "--methods", "random-actions", "--episodes", "1", "--quick", "--workers", "1"]


def test_the_plan_is_printed_and_nothing_is_made(pinwm, tmp_path: Path):
    code, output, errors = pinwm("reproduce", "policies", "--plan", "-o", str(tmp_path / "out"), *OPTIONS)
    assert (code, errors) == (0, "")
    first, second, last = output.splitlines()
    assert first.split()[0] == "evaluations/push/random-actions/seed-0"
    assert second == "0 of 1 are made"
    assert last.startswith("about 0.0 h of one core are left")
    assert not (tmp_path / "out").exists()


def test_a_table_is_made_once_and_reported(pinwm, tmp_path: Path):
    out = tmp_path / "out"
    code, output, errors = pinwm("reproduce", "policies", "-o", str(out), *OPTIONS)
    assert (code, errors) == (0, "")
    assert output.splitlines()[-1] == f"wrote {out / 'report.md'}"
    done = out / "evaluations/push/random-actions/seed-0/done.json"
    assert json.loads(done.read_text())["result"]["episodes"] == 1
    made = done.stat().st_mtime_ns
    code, _, errors = pinwm("reproduce", "policies", "-o", str(out), "--no-resume", *OPTIONS)
    assert code == 1
    assert "1 cells that are made or begun; allowed: a new folder, or --resume" in errors
    assert pinwm("reproduce", "policies", "-o", str(out), "--resume", *OPTIONS)[0] == 0
    assert done.stat().st_mtime_ns == made
    code, _, errors = pinwm("reproduce", "report", "policies", "-o", str(out), "--report", str(tmp_path / "a.md"))
    # Without `--quick` the cells would have other settings.
    assert code == 1
    assert "a cell of other settings (episodes: 1, and not 100); allowed: the options that it was made with" in errors
    code, output, _ = pinwm(
        "reproduce", "report", "policies", "-o", str(out), "--report", str(tmp_path / "a.md"), *OPTIONS
    )
    assert (code, output) == (0, f"wrote {tmp_path / 'a.md'}\n")
    assert "| push | random-actions |" in (tmp_path / "a.md").read_text()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["tables"], "TABLE: got 'tables'"),
        (["policies", "--methods", "dreams"], "--methods: got 'dreams'"),
        (["parameters", "--methods", "robogsim"], "--methods: got robogsim, none of which is in parameters"),
        (["policies", "--quick", "--episodes", "-1"], "--episodes: got -1"),
        (["policies", "--plan", "--executor", "dask"], "executor: got 'dask'"),
        (["policies", "--plan", "--workers", "0"], "--workers: got 0"),
        (["report"], "none of the cells of these tables"),
    ],
)
def test_options_that_make_no_sense_are_refused(pinwm, tmp_path, arguments, words):
    code, _, errors = pinwm("reproduce", *arguments, "-o", str(tmp_path))
    assert code == 1
    assert words in errors
    assert list(tmp_path.iterdir()) == []


def test_seeds_that_are_named_are_kept():
    assert ReproduceRun(("policies",)).resolved().seeds == 1
    assert [ReproduceRun(("report",), seeds=seeds).resolved().seeds for seeds in (1, 3)] == [1, 3]
