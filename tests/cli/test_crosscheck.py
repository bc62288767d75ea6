# SPDX-License-Identifier: MIT
import csv

import cv2
import pytest

from tests.report.samples import write_identified, write_push
from tests.twin.samples import estimates

SCENARIO = """
units: {length: m, mass: kg, time: s, angle: rad}
name: cube
object: cube
theta: {mass: 1.0, friction_floor: 0.3, friction_pusher: 0.3, restitution: 0.0}
start: {yaw: [-3.1, 3.1]}
"""


@pytest.fixture(scope="module")
def scenario(tmp_path_factory):
    path = tmp_path_factory.mktemp("check") / "cube.scenario.yaml"
    path.write_text(SCENARIO)
    return path


def test_a_twin_that_agrees_passes(pinwm, scenario, tmp_path):
    arguments = [str(scenario), "--engine", "point", "--pushes", "2", "--processes", "1", "-o", str(tmp_path / "new")]
    code, output, errors = pinwm("crosscheck", *arguments)
    assert (code, errors) == (0, "")
    assert "the plants have the twin's own parameters; this checks its physics" in output
    verdict = next(line for line in output.splitlines() if line.startswith("PASS point: median of 2 pushes"))
    assert verdict.endswith("threshold of the medians 3.0 mm and 2.0°")
    rows = list(csv.DictReader((tmp_path / "new/crosscheck.csv").open()))
    assert [(row["push"], row["engine"]) for row in rows] == [(k, name) for k in "01" for name in ("twin", "point")]
    twin, point = rows[:2]
    assert twin["translation"] == ""
    assert 0 < float(point["translation"]) <= float(point["path_translation"]) < 0.02
    for row in rows:
        assert sum(float(row[f"floor_{mode}"]) for mode in ("separated", "sticking", "sliding")) == pytest.approx(1)
        # It slides on by some millimetres, at mu g = 2.9 m/s^2 and 1 kg.
        assert 0.003 * 2.9 < float(row["energy_stop"]) < float(row["energy_peak"])
        assert row["failure"] == ""
    assert cv2.imread(str(tmp_path / "new/crosscheck.png")).shape[1] > 800
    assert sorted(path.name for path in (tmp_path / "new").iterdir()) == [
        "crosscheck.config.yaml",
        "crosscheck.csv",
        "crosscheck.png",
    ]


def test_a_wrong_friction_fails_and_a_strict_threshold_too(pinwm, scenario, tmp_path):
    truth = tmp_path / "ground_truth.yaml"
    truth.write_text("friction_floor: 0.21\n")
    base = ["--engine", "point", "--pushes", "1", "--processes", "1"]
    code, output, errors = pinwm("crosscheck", str(scenario), *base, "--truth", str(truth))
    assert (code, errors) == (1, "")
    assert "ground_truth.yaml; this checks the twin's physics and parameters" in output
    assert "FAIL point" in output
    code, output, _ = pinwm("crosscheck", str(scenario), *base, "--threshold-translation", "1e-7")
    assert code == 1
    assert "FAIL point" in output


@pytest.mark.parametrize("engines", [["point"], pytest.param(["hydroelastic", "point"], marks=pytest.mark.nightly)])
def test_a_twins_folder_is_checked_against_engines(pinwm, tmp_path, engines):
    write_push(tmp_path / "capture")
    theta = estimates(restitution_floor=0.0, restitution_pusher=0.0, friction_floor=0.5, friction_pusher=0.3)
    write_identified(tmp_path / "twin", tmp_path / "capture", theta=theta)
    arguments = [str(tmp_path / "twin"), "--engine", *engines, "--pushes", "1"]
    # This twin stands on its corners with 8 directions of friction, and so turns otherwise than Drake's.
    code, output, errors = pinwm(
        "crosscheck", *arguments, "--threshold-translation", "0.03", "--threshold-rotation", "40"
    )
    assert (code, errors) == (0, "")
    assert all(f"PASS {engine}" in output for engine in engines)
    assert "threshold of the medians 30.0 mm and 40.0°" in output


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--engine", "bullet"], "engine: got 'bullet'; allowed: hydroelastic, point"),
        (["--pushes", "0"], "pushes: got 0"),
        (["--truth", "{tmp}/none.yaml"], "none.yaml"),
        (["--truth", "{tmp}/empty.yaml"], "empty.yaml: no parameter of a twin"),
        (["--truth", "{tmp}/wild.yaml"], "friction_floor"),
        (["-o", "{tmp}/empty.yaml"], "empty.yaml"),
    ],
)
def test_what_makes_no_sense_is_refused(pinwm, scenario, tmp_path, arguments, message):
    (tmp_path / "empty.yaml").write_text("colour: 3\n")
    (tmp_path / "wild.yaml").write_text("friction_floor: much\n")
    given = [argument.format(tmp=tmp_path) for argument in arguments]
    code, _, errors = pinwm("crosscheck", str(scenario), *given)
    assert code == 1
    assert message in errors


def test_a_missing_twin_is_named(pinwm, tmp_path):
    code, _, errors = pinwm("crosscheck", str(tmp_path / "none"))
    assert code == 1
    assert "none: no such scenario; allowed: a file, a twin's folder, or one of" in errors
