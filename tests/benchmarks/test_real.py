# SPDX-License-Identifier: MIT
"""Captures and figures of the benchmark of real measurements, on numbers that are made up."""

import json
import math
from functools import partial

import numpy as np
import pytest

from benchmarks.real import __main__ as command
from benchmarks.real import tables
from benchmarks.real.captures import OUTLINES, Toss, mit_push, triangle_pushes, write_mit, write_tosses
from benchmarks.real.evaluate import summary
from benchmarks.real.sets import Job, mit
from pinwm_drake.capture.episodes import read_episode
from pinwm_drake.capture.scene import load_capture
from pinwm_drake.geometry.meshes import load_mesh, mass_properties

ROW = np.array([0.3, 0.02, 0.5, 0.32, 0.03, 0.7, 0.22, 0.0, 0.262, 0.028])


def test_a_row_of_mit_is_a_push_at_its_speed(tmp_path):
    folder = write_mit(tmp_path / "abs_tri1", "abs_tri1", [mit_push(ROW), mit_push(ROW + 0.01)])
    capture = load_capture(folder)
    episode = read_episode(capture, "0000")
    assert capture.episode_names == ["0000", "0001"]
    log, poses = episode.trajectory, episode.object_poses
    speed = np.linalg.norm(np.diff(log.p_WP, axis=0), axis=1)[0] / np.diff(log.t)[0]
    assert speed == pytest.approx(0.01)
    assert log.p_WP[:2, :2].ravel().tolist() == pytest.approx(ROW[6:].tolist())
    assert poses.p_WO[:, :2].ravel().tolist() == pytest.approx([0.3, 0.02, 0.32, 0.03])
    assert 2 * math.atan2(poses.q_WO[1, 3], poses.q_WO[1, 0]) == pytest.approx(0.7)
    assert episode.start.p.tolist() == pytest.approx([0.3, 0.02, 0.0065])
    # The pusher stands on the table, over the floor.
    assert log.p_WP[0, 2] - 0.5 * capture.pusher.shape.length > 0.0
    center = mass_properties(load_mesh(capture.object.mesh_path), mass=1.0).p_com
    assert center == pytest.approx([*OUTLINES["tri1"].mean(axis=0), 0.0], abs=1e-6)


def test_a_set_of_the_triangle_is_read_push_by_push():
    rows = [[0, 0.0, 0.5, 0.0, 0.02], [0, 0.1, 0.51, 0.0, 0.02], [1, 0.0, 0.6, 0.0, 0.02], [1, 0.2, 0.6, 0.1, 0.02]]
    poses = np.arange(6.0).reshape(2, 3)
    first, second = triangle_pushes({"pre": poses, "post": poses + 1.0, "finger": np.array(rows)})
    assert first.tip.tolist() == [[0.5, 0.0], [0.51, 0.0]]
    assert (second.tip_t.tolist(), second.poses.tolist()) == ([0.0, 0.2], [[3, 4, 5], [4, 5, 6]])


def test_a_toss_has_its_velocity(tmp_path):
    t = np.arange(4) / 148.0
    level = np.tile([1.0, 0.0, 0.0, 0.0], (4, 1))
    toss = Toss(t, level, np.outer(1.0 - t, [0.0, 0.0, 1.0]), np.array([0.0, 0.0, 2.0, 1.0, 0.0, -1.0]))
    capture = load_capture(write_tosses(tmp_path, [toss]))
    episode = read_episode(capture, "0000")
    assert episode.start_velocity.tolist() == [0.0, 0.0, 2.0, 1.0, 0.0, -1.0]
    assert len(episode.t) == 4


def prediction(dx, spread, **others):
    return {"end": [dx, 0.0, 0.1], "spread": [spread, spread, 0.1], "path": [0.5 * dx, 0.05], **others}


def test_the_summary_counts_what_intervals_hold():
    rows = [prediction(0.003, 0.001), prediction(0.001, 0.001)]
    found = summary({"predictions": rows})
    assert found["mm"] == pytest.approx(2.0)
    assert found["deg"] == pytest.approx(math.degrees(0.1))
    assert found["path_mm"] == pytest.approx(1.0)
    assert found["cover"] == pytest.approx(5 / 6)
    # 3 mm are within 1.96 times 2.24 mm, of the prediction and the measurement together.
    noise = [0.002, 0.0, 0.0]
    assert summary({"predictions": rows, "noise": noise})["cover"] == 1.0
    assert summary({"predictions": rows, "noise": None})["cover"] == pytest.approx(5 / 6)


def test_a_stored_case_is_not_made_again_and_results_are_written(tmp_path, monkeypatch):
    made = []

    def make():
        made.append(1)
        return {"predictions": [prediction(0.002, 0.01)], "estimates": {}}

    about = {
        "set": "mit",
        "name": "abs_rect1",
        "number": 1,
        "still": [20, 10],
        "cmu": {"quartic": [2, 3], "quadratic": [3, 4]},
    }
    job = Job(tmp_path / "case.json", about, partial(make))
    assert job.run() == job.run()
    assert made == [1]
    monkeypatch.setattr(command, "_RESULTS", tmp_path)
    command.write([job.run() | {"number": number} for number in (1, 5, 5)])
    cases = json.loads((tmp_path / "real.json").read_text())["cases"]
    assert len(cases) == 3
    assert "| abs_rect1 | 20.00, 10.00 | 2.00, 5.73 (100 %) | 2.00, 5.73 (100 %) |  |" in tables.mit(cases)


def test_pushes_to_fit_are_no_pushes_to_predict(tmp_path):
    folder = tmp_path / "data/mit_quasistatic"
    folder.mkdir(parents=True)
    train, test = ROW + 0.001 * np.arange(30)[:, None], ROW + 0.002 * np.arange(40)[:, None]
    np.savez(folder / "abs_rect1.npz", train=train, test=test, zhou_poly4=test[:, 3:6], zhou_quadratic=test[:, 3:6])
    jobs = list(mit(tmp_path / "data", tmp_path / "out", 10))
    assert [job.about["number"] for job in jobs] == [1, 5, 20, 1, 1]
    for job in jobs:
        _, _, fit, others, _ = job.make.args
        assert len(fit) == job.about["number"]
        assert len(others) == 10
        assert not set(fit) & set(others)
    assert jobs[0].about["cmu"]["quartic"] == [0.0, 0.0]
