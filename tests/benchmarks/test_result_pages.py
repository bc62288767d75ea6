# SPDX-License-Identifier: MIT
import json
import math
import re
import statistics

import pytest

from benchmarks.result_pages import BLOCKS, ROOT, compared, coverage_engines, headline, review
from benchmarks.results import with_block


@pytest.mark.parametrize(
    ("page", "name", "make"),
    BLOCKS,
    ids=lambda value: getattr(value, "__name__", None) or getattr(value, "name", value),
)
def test_a_table_of_a_page_is_the_one_that_its_stored_results_give(page, name, make):
    text = page.read_text(encoding="utf-8")
    assert with_block(text, name, make()) == text


def test_each_block_of_the_results_and_the_readme_is_written_from_stored_results():
    pages = [ROOT / "README.md", ROOT / "docs/explanation/physics.md", *(ROOT / "docs/results").glob("*.md")]
    found = {(page, name) for page in pages for name in re.findall(r"<!-- begin (\w+) -->", page.read_text("utf-8"))}
    assert found == {(page, name) for page, name, _ in BLOCKS}


def test_the_headline_has_one_figure_a_cell_and_both_seeds_and_trainings_of_the_flip():
    rows = [line.strip("| ").split(" | ") for line in headline().splitlines()[2:]]
    assert {len(row) for row in rows} == {4}
    assert all(re.fullmatch(r"[\d.]+( %)?", figure) for row in rows for figure in row[1:3])
    assert all(re.fullmatch(r"[\d.]+ to [\d.]+( %)?", row[3]) for row in rows)
    flips = [row[2] for row in rows if row[0].startswith("flip")]
    assert flips == ["100 %", "97 %", "99 %", "100 %", "92 %"]


def test_intervals_of_a_reviewers_shares_are_wilsons():
    # Wilson, 1927, for 5 of 100: (p + z²/2n ± z √(p(1 - p)/n + z²/4n²)) / (1 + z²/n), z = 1.96.
    row = next(line for line in review().splitlines() if "pusher" in line)
    n, p, z = 100, 0.05, 1.96
    middle, half = p + z * z / (2 * n), z * (p * (1 - p) / n + z * z / (4 * n * n)) ** 0.5
    low, high = (100 * (middle + sign * half) / (1 + z * z / n) for sign in (-1, 1))
    assert f"| 5 % | {low:.3g} to {high:.3g} % | 100 |" in row


def stored(name):
    return json.loads((ROOT / "docs/results" / name).read_text("utf-8"))


def test_a_row_of_an_engine_has_its_own_median_and_worst():
    results = [
        one for group in stored("next_push.json")["groups"] if group["kind"] == "clean" for one in group["results"]
    ]
    chosen = [one for one in results if one["method"] == "truth" and one["capture"].split("_")[1] == "mujoco"]
    scores = [(1e3 * score["position"], math.degrees(score["yaw"])) for one in chosen for score in one["predictions"]]
    median, worst = (
        [f"{take(column):.2f}" for column in zip(*scores, strict=True)] for take in (statistics.median, max)
    )
    row = next(line for line in compared().splitlines() if "MuJoCo" in line).strip("| ").split(" | ")
    assert row[1:3] == [str(len(chosen)), str(len(scores))]
    assert (row[3], row[5]) == (f"{median[0]} mm, {median[1]}°", f"{worst[0]} mm, {worst[1]}°")


def test_coverage_of_an_engine_counts_ranks_between_2_5_and_97_5_per_cent():
    yaws = [one["yaw"] for one in stored("coverage.json")["ranks"] if "bullet" in one["capture"]]
    row = next(line for line in coverage_engines().splitlines() if "Bullet" in line).strip("| ").split(" | ")
    share = 100 * sum(0.025 <= rank <= 0.975 for rank in yaws) / len(yaws)
    assert row[1] == str(len(yaws))
    assert row[-1].startswith(f"{share:.0f} % (")


def test_a_page_without_markers_is_refused():
    with pytest.raises(ValueError, match="'<!-- begin b -->' and '<!-- end b -->' are missing"):
        with_block("<!-- begin a -->\n<!-- end a -->", "b", "text")
