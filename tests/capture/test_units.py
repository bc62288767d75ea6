# SPDX-License-Identifier: MIT
import dataclasses
import warnings

import numpy as np
import pytest
import torch
import trimesh

from pinwm_drake.capture.check import check_capture
from pinwm_drake.capture.episode_tables import PusherTrajectory
from pinwm_drake.capture.episodes import read_episode, tell_doubts
from pinwm_drake.capture.scene import load_capture
from pinwm_drake.capture.units import (
    position_doubts,
    require_computable,
    scale_doubts,
    scene_doubts,
    size_doubts,
    time_doubts,
)
from pinwm_drake.errors import InputError
from pinwm_drake.spatial.poses import Pose
from tests.capture.pushed_cube import SIDE, X_WO, trajectory
from tests.capture.test_check import EPISODE, edit_column, edit_json, edit_yaml, some


def push(duration=2.0, rate=240.0, speed=0.15):
    """A push by 60 mm whose log ends at `duration`."""
    t = np.linspace(0, duration, round(duration * rate) + 1)
    x = np.minimum(speed * t, 0.06) - 0.08
    v = np.where(x < -0.02, speed, 0.0)
    zero, one = np.zeros_like(t), np.ones_like(t)
    p_WP, q_WP = np.stack([x, zero, 0.03 + zero], -1), np.stack([one, zero, zero, zero], -1)
    return PusherTrajectory(t, p_WP, q_WP, np.stack([v, zero, zero], -1), None)


def in_time(log, factor):
    return dataclasses.replace(log, t=log.t * factor, v_WP=log.v_WP / factor)


def in_length(log, factor):
    return dataclasses.replace(log, p_WP=log.p_WP * factor, v_WP=log.v_WP * factor)


def words(doubts):
    return " ".join(str(doubt) for doubt in doubts)


@pytest.mark.parametrize("rate", [5.0, 24.0, 240.0])
@pytest.mark.parametrize("speed", [0.02, 0.15, 1.0])
@pytest.mark.parametrize("duration", [0.6, 3.0, 20.0])
def test_plausible_pushes_cause_no_doubt(tmp_path, duration, speed, rate):
    log = push(duration, speed=speed)
    assert not time_doubts(tmp_path, np.arange(0, duration, 1 / rate), log)


@pytest.mark.parametrize(
    ("factor", "proposal"),
    [
        (1e3, "are they milliseconds? divide by 1000"),
        (1e6, "are they microseconds? divide by 1e+06"),
        (1e9, "are they nanoseconds? divide by 1e+09"),
        (1 / 60, "are they minutes? multiply by 60"),
        (1e-3, "are they seconds divided by 1000? multiply by 1000"),
    ],
)
@pytest.mark.parametrize("duration", [0.6, 2.0, 5.0])
def test_times_in_another_unit_are_told_with_the_factor_in_the_right_direction(tmp_path, duration, factor, proposal):
    log, t = push(duration), np.arange(0, duration, 1 / 24)
    assert proposal in words(time_doubts(tmp_path, factor * t, in_time(log, factor)))


def test_numbers_of_frames_for_times(tmp_path):
    doubts = time_doubts(tmp_path, np.arange(48.0), in_time(push(2.0, rate=24.0), 24.0))
    assert "numbers of frames? divide by the frames per second" in words(doubts)


@pytest.mark.parametrize("factor", [1e3, 1e-3])
def test_images_on_a_clock_of_another_unit_than_the_log(tmp_path, factor):
    doubts = words(time_doubts(tmp_path, factor * np.arange(48) / 24, push()))
    assert "frames.csv" in doubts
    assert ("divide by 1000" if factor > 1 else "multiply by 1000") in doubts


@pytest.mark.parametrize(("factor", "unit"), [(1e3, "millimetres"), (1e2, "centimetres")])
def test_velocities_in_another_unit(tmp_path, factor, unit):
    log = push()
    doubts = time_doubts(tmp_path, None, dataclasses.replace(log, v_WP=factor * log.v_WP))
    assert f"{unit} per second? divide by {factor:.0f}" in words(doubts)


@pytest.mark.parametrize(
    ("factor", "proposal"),
    [
        (1e3, "millimetres? divide by 1000"),
        (1e2, "centimetres? divide by 100"),
        (1e-3, "metres divided by 1000? multiply by 1000"),
    ],
)
def test_positions_in_another_unit(tmp_path, factor, proposal):
    cube, ball = trimesh.creation.box((SIDE,) * 3), trimesh.creation.icosphere(radius=0.012)
    assert not position_doubts(tmp_path, push(), cube, X_WO(), ball)
    assert proposal in words(position_doubts(tmp_path, in_length(push(), factor), cube, X_WO(), ball))


@pytest.mark.parametrize(
    ("extent", "proposal"),
    [
        (4.0, "is it in centimetres? divide by 100"),
        (3.0, "is it in inches? divide by 39.37"),
        (80.0, "is it in millimetres? divide by 1000"),
        (0.0001, "is it in metres divided by 1000? multiply by 1000"),
    ],
)
def test_sizes_in_another_unit(extent, proposal):
    assert proposal in words(size_doubts("mesh.obj", trimesh.creation.box((extent,) * 3)))


@pytest.mark.parametrize("extent", [0.006, 0.08, 0.9])
def test_plausible_sizes_cause_no_doubt(extent):
    assert not size_doubts("mesh.obj", trimesh.creation.box((extent,) * 3))


@pytest.mark.parametrize(
    ("values", "proposal"),
    [
        ({"gravity": 981.0}, "is it in cm/s^2? divide by 100"),
        ({"gravity": 32.2}, "is it in ft/s^2? divide by 3.28"),
        ({"mass": 200.0}, "is it in grams? divide by 1000"),
        ({"mass": 0.0002}, "multiply by 1000"),
        ({"p": [0.0, 12000.0, 30.0]}, "is it in millimetres? divide by 1000"),
    ],
)
def test_numbers_of_a_scene_in_another_unit(values, proposal):
    cube = trimesh.creation.box((SIDE,) * 3)
    scene = {"mesh": cube, "X_WO": X_WO(), "floor_height": 0.0, "gravity": 9.81, "mass": 0.2}
    assert not scene_doubts("capture.yaml", **scene)
    if "p" in values:
        values = {"X_WO": Pose(X_WO().q, torch.tensor(values["p"], dtype=torch.float64))}
    assert proposal in words(scene_doubts("capture.yaml", **scene | values))


def test_no_views_cause_no_doubt_about_the_scale():
    assert not scale_doubts("transforms.json", [], trimesh.creation.box((1, 1, 1)), X_WO())


@pytest.mark.parametrize(("factor", "unit"), [(1e3, "millimetres? divide by 1000"), (39.37, "inches? divide by 39.37")])
def test_camera_poses_in_another_unit_are_told_by_the_check(pushed_cube, factor, unit):
    def scale(document):
        for frame in document["frames"]:
            for row in frame["transform_matrix"][:3]:
                row[3] *= factor

    edit_json(pushed_cube, "static/transforms.json", scale)
    some(pushed_cube, "warning", "static/transforms.json", unit, f"--scale {1 / factor:.3g}")


def in_milliseconds(folder):
    for table in ("frames.csv", "trajectory.csv", "object_poses.csv"):
        edit_column(folder, table, "t", lambda t: 1000 * t)
    edit_column(folder, "trajectory.csv", "vx", lambda v: v / 1000)


def test_what_would_not_end_is_told_by_the_check_and_refused_before_it_is_computed(pushed_cube):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        tell_doubts(read_episode(load_capture(pushed_cube), "0000"))
    in_milliseconds(pushed_cube)
    with pytest.raises(InputError, match="are they milliseconds"):
        tell_doubts(read_episode(load_capture(pushed_cube), "0000"))
    some(pushed_cube, "warning", f"{EPISODE}/trajectory.csv", "are they milliseconds? divide by 1000")


def test_the_check_warns_of_grams_and_of_a_pusher_in_centimetres(pushed_cube):
    edit_yaml(pushed_cube, lambda d: d["object"].update(mass=200.0))
    edit_yaml(pushed_cube, lambda d: d["pusher"]["shape"].update(radius=1.2))
    messages = words(problem.problem for problem in check_capture(pushed_cube).problems)
    assert "is it in grams? divide by 1000" in messages
    assert "is it in centimetres? divide by 100" in messages


def test_slow_pushes_that_can_be_computed_are_told_only(tmp_path):
    doubts = require_computable(tmp_path, np.arange(0, 100, 1 / 24), push(100.0, rate=24.0))
    assert "times that run over 100 s" in words(doubts)


def test_a_shared_capture_of_a_robot_causes_no_doubt(shared):
    messages = [str(problem.problem) for problem in check_capture(shared / "data/real/mit_steel_capture").problems]
    assert not messages


def test_the_log_of_the_test_capture_is_plausible(tmp_path):
    log = trajectory()
    assert not time_doubts(tmp_path, log.t, log)
