# SPDX-License-Identifier: MIT
import csv
import math
import re

import cv2
import numpy as np
import pytest
import trimesh

from pinwm_drake.demo.push.options import PUSHER_SHAPES, PushOptions
from pinwm_drake.demo.push.report import push_figure
from pinwm_drake.demo.push.scene import PushRecord, simulate_push


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--friction", "-0.1"], "--friction: got -0.1; allowed: 0 or more"),
        (["--friction", "inf"], "--friction: got inf; allowed: 0 or more"),
        (["--pusher-friction", "nan"], "--pusher-friction: got nan; allowed: 0 or more"),
        (["--pusher", "finger"], "--pusher: got 'finger'; allowed: sphere, capsule, cylinder"),
        (["--time-step", "0"], "--time-step: got 0.0; allowed: more than 0, up to 0.02 s"),
        (["--seconds", "-1"], "--seconds: got -1.0; allowed: more than 0, up to 60 s"),
        (["--speed", "0"], "--speed: got 0.0; allowed: more than 0, up to 2 m/s"),
        (["--offset", "0.06"], "--offset: got 0.06; allowed: -0.05 to 0.05 m"),
    ],
)
def test_bad_input_is_one_line_and_exits_with_1(pinwm, tmp_path, arguments, message):
    out = tmp_path / "out"
    assert pinwm("demo", "push", "--out", str(out), *arguments) == (1, "", f"pinwm: {message}\n")
    assert not out.exists()


def test_a_folder_that_cannot_be_written_is_refused(pinwm, tmp_path):
    (tmp_path / "file").write_text("")
    code, output, errors = pinwm("demo", "push", "--out", str(tmp_path / "file"))
    assert (code, output) == (1, "")
    assert re.fullmatch(r"pinwm: .*file: got File exists; allowed: a folder that can be written to\n", errors)


def test_push_writes_table_figure_and_video(pinwm, tmp_path):
    out = tmp_path / "new/folder"
    code, output, errors = pinwm("demo", "push", "--out", str(out), "--seconds", "0.5", "--speed", "0.2")
    assert (code, errors) == (0, "")
    assert "d yaw / d friction on the floor" in output
    assert sorted(path.name for path in out.iterdir()) == ["push.config.yaml", "push.mp4", "push.png", "trajectory.csv"]

    with (out / "trajectory.csv").open() as file:
        rows = [{name: float(value) for name, value in row.items()} for row in csv.DictReader(file)]
    # 60 records a second, the start among them.
    assert len(rows) == 31
    assert [rows[0]["t"], rows[-1]["t"]] == [0.0, pytest.approx(0.5)]
    # The pusher moves for two thirds of the time.
    assert rows[-1]["pusher_y"] - rows[0]["pusher_y"] == pytest.approx(0.2 * 0.5 * 2 / 3, rel=1e-6)
    assert rows[-1]["py"] > 0.05

    assert cv2.imread(str(out / "push.png")).shape[2] == 3
    video = cv2.VideoCapture(str(out / "push.mp4"))
    assert video.get(cv2.CAP_PROP_FRAME_COUNT) == 16
    assert video.get(cv2.CAP_PROP_FPS) == pytest.approx(30)


def make_options(**changes):
    options = {
        "friction": 0.1,
        "pusher_friction": 0.1,
        "speed": 0.15,
        "offset": 0.02,
        "seconds": 1.0,
        "time_step": 1 / 240,
        "pusher": "sphere",
    }
    return PushOptions(**(options | changes))


def simulate(**changes):
    return simulate_push(make_options(**changes), lambda stage, share: None)


@pytest.mark.parametrize("pusher", PUSHER_SHAPES)
def test_derivatives_agree_with_central_differences(pusher):
    # At offsets of 1, 1.3 and 2 cm a kink lies within 1e-5 m; at 1.2 cm there is none.
    result = simulate(pusher=pusher, offset=0.012)
    assert result.p_WB[-1, 1] > 0.05
    for derivative in result.derivatives:
        # The bar of the physics' own tests; and solver tolerance over difference step, as that with respect to the
        # pusher's friction changes its sign near here.
        assert derivative.adjoint == pytest.approx(derivative.difference, rel=1e-4, abs=3e-6), derivative.name


def test_a_push_beside_the_centre_turns_the_block_away_from_it():
    # A force along +y at x > 0 has a moment about +z.
    right, left = simulate(offset=0.02), simulate(offset=-0.02)
    assert right.yaw[-1] > math.radians(5)
    assert left.yaw[-1] < -math.radians(5)


def test_options_set_the_records():
    options = make_options(seconds=1.0, time_step=0.001)
    assert options.steps_per_record == 17  # 1 / (60 · 0.001) = 16.7
    assert options.records == 59  # 1 / 0.017 = 58.8


def test_the_push_figure_is_drawn(tmp_path):
    count = 30
    times = np.linspace(0, 1, count)
    path = np.column_stack((np.zeros(count), 0.2 * times, np.zeros(count)))
    q_WB = np.column_stack((np.cos(times / 2), np.zeros((count, 2)), np.sin(times / 2)))
    V_WB = np.tile([0.0, 0.0, 1.0, 0.0, 0.2, 0.0], (count, 1))
    record = PushRecord(times, q_WB, path, V_WB, path - [0, 0.06, 0], ())
    push_figure(tmp_path / "push.png", trimesh.creation.box((0.1, 0.1, 0.05)), record, "a push")
    image = cv2.imread(str(tmp_path / "push.png"))
    assert image.shape == (672, 1200, 3)
    assert image.std() > 10
