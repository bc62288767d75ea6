# SPDX-License-Identifier: MIT
import dataclasses

import numpy as np
import pytest
from scipy.stats import binomtest

from pinwm_drake.paper.reproduce.cell import CellStore, settings_of
from pinwm_drake.paper.reproduce.figures import table_figures
from pinwm_drake.paper.reproduce.request import ReproduceRequest
from pinwm_drake.paper.reproduce.run import TABLES, read_results, tables_of, write_report
from pinwm_drake.paper.reproduce.twins import CaptureCell

REQUEST = ReproduceRequest(seeds=2)


def evaluation(successes, steps, episodes=100):
    low, high = binomtest(successes, episodes).proportion_ci(method="wilson")
    return {
        "episodes": episodes,
        "success_rate": successes / episodes,
        "interval_95": [low, high],
        "steps": {"successes": {"mean": steps, "median": steps}, "all": {"mean": 30.0, "median": 30.0}},
    }


def errors(translation, rotation):
    parts = {"translation": translation, "rotation": rotation}
    return {name: {"mean": mean, "median": 0.5 * mean, "high": 3.0 * mean} for name, mean in parts.items()}


def results_of(table, make):
    """Results of the cells of a table: what a function gives of each, None for what is missing."""
    return {
        cell: None if (found := make(cell)) is None else {"result": found, "provenance": {"minutes": 1.0}}
        for cell in table.cells(REQUEST)
    }


def titled(figure):
    return {axes.get_title(): axes for axes in figure.axes}


def rows(axes):
    """Names of a panel's rows."""
    return [label.get_text() for label in axes.get_yticklabels()]


def notes(axes):
    """Words within a panel, by the row."""
    return {round(text.get_position()[1]): text.get_text() for text in axes.texts}


def markers(axes):
    """Points (n, 2) of a panel's lines that are drawn as points."""
    return np.concatenate([line.get_xydata() for line in axes.lines if line.get_marker() == "o"])


def test_nothing_is_drawn_where_nothing_is_made():
    for table in TABLES.values():
        assert table_figures(table, REQUEST, results_of(table, lambda cell: None)) == {}


def test_rates_are_drawn_with_their_intervals_and_missing_systems_are_named():
    found = {("pin-wm", 0): (97, 30.0), ("pin-wm", 1): (95, 32.0), ("random", 0): (0, None)}

    def make(cell):
        return evaluation(*found[key]) if (key := (cell.system, cell.seed)) in found and cell.task == "push" else None

    table = TABLES["policies"]
    figures = table_figures(table, REQUEST, results_of(table, make))
    assert list(figures) == ["policies"]
    panels = titled(figures["policies"])
    assert list(panels) == ["push: success", "push: actions of a success"]  # nothing of flip is made
    success, actions = panels.values()
    names = rows(success)
    at = names.index("pin-wm")
    widths = [bar.get_width() for bar in success.patches]
    assert widths[at] == pytest.approx(0.96)
    assert sum(widths) == pytest.approx(0.96)
    assert sorted(x for x, y in markers(success) if round(y) == at) == [0.95, 0.97]
    drawn = [path.vertices[:, 0] for one in success.collections for path in one.get_paths()]
    expected = [binomtest(n, 100).proportion_ci(method="wilson") for n in (97, 95, 0)]
    assert np.array(sorted(map(list, drawn))) == pytest.approx(np.array(sorted(expected)))
    assert actions.patches[at].get_width() == pytest.approx(31.0)
    missing = set(range(len(names))) - {at, names.index("random")}
    assert notes(success) == dict.fromkeys(missing, "not run")
    assert notes(actions) == {**dict.fromkeys(missing, "not run"), names.index("random"): "no success"}


def test_errors_of_twins_are_drawn_by_system_and_over_the_iterations():
    def make(cell):
        if cell.origin == "2d-physics":
            return None
        found = errors((2e-3 if cell.origin == "pin-wm" else 4e-3) * (5.0 if cell.outcomes.rest else 1.0), 0.1)
        curve = [{"iteration": k, "loss": 1.0} | errors(1e-3 * (9 - k), 0.2) for k in range(8)]
        return found | ({"curve": curve} if cell.origin == "pin-wm" else {})

    table = TABLES["one-step"]
    figures = table_figures(table, REQUEST, results_of(table, make))
    assert list(figures) == ["one-step", "one-step-curve", "one-step-at-rest"]
    resting = titled(figures["one-step-at-rest"])["push: translation [mm]"]
    assert rows(resting) == ["pin-wm", "asid", "asid-generous", "2d-physics", "scene"]
    assert [x for x, y in markers(resting) if round(y) == 0] == pytest.approx([10.0, 10.0])
    panels = titled(figures["one-step"])
    assert list(panels) == [
        f"{task}: {part}" for task in ("push", "flip") for part in ("translation [mm]", "rotation [rad]")
    ]
    axes = panels["push: translation [mm]"]
    names = rows(axes)
    assert names == ["pin-wm", "asid", "asid-generous", "2d-physics", "scene", "dreamer-v2", "readout"]
    assert notes(axes) == {3: "not run"}
    points = markers(axes)
    assert [x for x, y in points if round(y) == 0] == pytest.approx([2.0, 2.0])
    assert [x for x, y in points if round(y) == 4] == pytest.approx([4.0])
    spans = [line.get_xdata() for line in axes.lines if line.get_marker() != "o"]
    assert list(spans[0]) == pytest.approx([1.0, 6.0])  # median to 95th percentile
    curves = figures["one-step-curve"].axes[0].lines
    assert {line.get_label() for line in curves} == {
        f"pin-wm/{task}/seed-{seed}" for task in ("push", "flip") for seed in (0, 1)
    }
    assert list(curves[0].get_ydata()) == pytest.approx([9, 8, 7, 6, 5, 4, 3, 2])


def test_errors_are_drawn_over_the_noise_and_missing_noise_is_named():
    def make(cell):
        capture = cell.twin.surfels.capture
        share = getattr(capture, "share", 0.0)
        missing = share == 0.01 and cell.outcomes.task == "push"
        return None if missing else errors(1e-3 * (1 + 100 * share) + 1e-4 * capture.seed, 0.1)

    table = TABLES["geometry-noise"]
    figures = table_figures(table, REQUEST, results_of(table, make))
    assert list(figures) == ["geometry-noise"]
    axes = figures["geometry-noise"].axes[0]
    lines = {line.get_label(): line.get_xydata() for line in axes.lines if line.get_marker() != "o"}
    fitted = "push, mesh fitted to the masks (not run: 1 %)"
    assert list(lines) == ["push (not run: 1 %)", fitted, "flip"]
    assert lines["push (not run: 1 %)"] == pytest.approx(np.array([[0.0, 1.05], [0.5, 1.55], [3.0, 4.05]]))
    assert lines[fitted] == pytest.approx(np.array([[0.5, 1.55], [3.0, 4.05]]))
    assert len(markers(axes)) == 3 * 2 + 2 * 2 + 4 * 2


def test_identified_parameters_are_drawn_beside_the_true_ones():
    def make(cell):
        if cell.only == "mass" or cell.surfels.capture.seed == 1 or cell.system == "2d-physics":
            return None
        value = 0.0305 if cell.system == "pin-wm" else 0.05
        told = cell.only == "friction_floor" and cell.system == "pin-wm"
        one = {"value": value, "interval": [0.029, 0.032] if told else None, "identifiable": told}
        return {"estimates": dict.fromkeys(("friction_floor", "mass", "restitution_floor"), one)}

    table = TABLES["parameters"]
    panels = titled(table_figures(table, REQUEST, results_of(table, make))["parameters"])
    assert set(panels) == {
        f"{task}: {label}"
        for task in ("push", "flip")
        for label in ("friction_floor", "mass", "mass, with the force on the pusher", "restitution_floor")
    }
    for task, true in (("push", 0.03), ("flip", 0.2)):
        axes = panels[f"{task}: friction_floor"]
        assert [label.get_text() for label in axes.get_xticklabels()] == [
            "pin-wm",
            "asid",
            "asid-generous",
            "2d-physics",
        ]
        heights = {line.get_linestyle(): line.get_ydata() for line in axes.lines}
        assert list(heights[":"]) == [true, true]
        assert list(heights["-"]) == [0.029, 0.032]
        assert markers(axes)[:, 1] == pytest.approx([0.0305, 0.05, 0.05])
        assert [text.get_text() for text in axes.texts] == ["not run"] * 5
    mass = panels["push: mass"]
    assert [text.get_text() for text in mass.texts] == ["not run"] * 6
    assert not [line for line in mass.lines if line.get_marker() == "o"]
    (forced,) = [line for line in panels["push: mass, with the force on the pusher"].lines if line.get_marker() == "o"]
    assert forced.get_markerfacecolor() == "white"  # the video does not tell


def test_the_report_links_the_figures_of_what_is_made(tmp_path):
    store, provenance = CellStore(tmp_path), {"minutes": 1.0, "commit": "", "machine": "none", "time": "now"}
    tables = tables_of(["policies", "one-step"])
    for cell in tables[0].cells(REQUEST)[:3]:
        found = {"settings": settings_of(cell), "result": evaluation(50, 10.0), "provenance": provenance}
        store.write(cell, found)
    write_report(tmp_path / "report.md", tables, REQUEST, tmp_path)
    assert [path.name for path in tmp_path.glob("*.png")] == ["report-policies.png"]
    text = (tmp_path / "report.md").read_text()
    assert text.count("![") == 1
    assert "![Policies](report-policies.png)" in text
    assert sum(one is not None for one in read_results(tables, REQUEST, tmp_path).values()) == 3


def test_seeds_that_were_not_run_are_listed_once(tmp_path):
    request = dataclasses.replace(REQUEST, seeds=3)
    tables, capture = tables_of(["one-step"]), CaptureCell("push", 0)
    provenance = {"minutes": 90.0, "commit": "", "machine": "none", "time": "now"}
    CellStore(tmp_path).write(capture, {"settings": settings_of(capture), "result": {}, "provenance": provenance})
    write_report(tmp_path / "report.md", tables, request, tmp_path)
    origin = (
        "1 cells in 1.5 h, those that other tables share included. Commits no repository; machines: none; now to now."
    )
    assert origin in (tmp_path / "report.md").read_text()
    rows = [
        line.split(" | ") for line in (tmp_path / "report.md").read_text().splitlines() if line.startswith("| push")
    ]
    assert "not run" in rows[0]
    assert {row[2].strip() for row in rows} <= {"", "0"}
    assert len(rows) == len({row[1] for row in rows})
