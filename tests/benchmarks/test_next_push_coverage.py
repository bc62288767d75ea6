# SPDX-License-Identifier: MIT
"""Tables and pictures of coverage, from ranks that are known."""

import numpy as np

from benchmarks.next_push.coverage import coverage_table, rank_histogram
from benchmarks.next_push.evaluate import table

KEYS = ("friction_floor", "friction_pusher", "x", "y", "yaw")


def rows_of(ranks):
    return [{"number": k, "ranks": dict.fromkeys(KEYS, float(rank))} for k, rank in enumerate(ranks)]


def cells(line):
    return [cell.strip() for cell in line.strip("|").split("|")]


def test_even_ranks_are_covered_as_they_should_be(tmp_path):
    rows = rows_of((np.arange(200) + 0.5) / 200)
    lines = coverage_table(rows)
    assert len(lines) == 2 + 4
    assert cells(lines[2])[1:3] == ["200", "50 % (43 to 57)"]
    assert cells(lines[2])[3].startswith("80 %")
    assert cells(lines[2])[4].startswith("95 %")
    # Both places of a push count.
    assert cells(lines[4])[1] == "400"
    rank_histogram(tmp_path / "ranks.png", rows)
    assert (tmp_path / "ranks.png").stat().st_size > 1000


def test_a_twin_that_is_too_sure_is_found_out():
    lines = coverage_table(rows_of(np.where(np.arange(100) % 2 == 0, 0.01, 0.6)))
    assert [cell.split(" %")[0] for cell in cells(lines[2])[2:]] == ["50", "50", "50"]


def test_intervals_of_the_last_pose_are_counted():
    score = {"position": 2e-3, "yaw": 0.02, "last": [1e-3, 0.0, 0.01], "spread": [1e-3, 1e-3, 1e-3]}
    results = [{"method": "ours", "pushes": [0], "predictions": [score] * 4}]
    (line,) = table(results)[2:]
    # x within, y within, yaw ten standard deviations off.
    assert cells(line)[:4] == ["ours", "1", "4", "2.00 mm, 1.15°"]
    assert cells(line)[6] == "67 % of 12"
