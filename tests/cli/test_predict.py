# SPDX-License-Identifier: MIT
import dataclasses
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from pinwm_drake.capture.episode_tables import read_pose_table
from pinwm_drake.capture.episodes import read_episode
from pinwm_drake.capture.scene import PusherGeometry, PusherShape, load_capture
from pinwm_drake.spatial.poses import Pose
from pinwm_drake.twin import origin
from pinwm_drake.twin.origin import (
    hash_capture,
    identified_push,
    registration_entry,
    seen_in,
    seen_start,
    start_pose,
    time_offset,
)
from pinwm_drake.twin.read import load_twin
from pinwm_drake.twin.twin import Estimate
from pinwm_drake.twin.write import write_twin
from tests.capture.cube import SIDE
from tests.report.samples import GAP, SPEED, write_identified, write_push
from tests.twin.samples import estimates

FRAMES = 5
LEVEL = torch.tensor([1.0, 0.0, 0.0, 0.0], dtype=torch.float64)
# Without bounce, and with so much friction that the cube stops at once where the pusher leaves it.
THETA = estimates(restitution_floor=0.0, restitution_pusher=0.0, friction_floor=0.5)


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """A capture with two episodes, and a twin of the first."""
    path = tmp_path_factory.mktemp("push")
    write_push(path / "capture", frames=FRAMES)
    write_push(path / "capture", frames=FRAMES, name="second", truth=False)
    write_identified(path / "twin", path / "capture", theta=THETA)
    return path


def test_a_cube_is_where_the_pusher_puts_it(pinwm, folder, tmp_path):
    out = tmp_path / "new/poses.csv"
    code, output, errors = pinwm("predict", str(folder / "twin"), str(folder / "capture/episodes/0000"), "-o", str(out))
    assert (code, errors) == (0, "")
    poses = read_pose_table(out)
    np.testing.assert_allclose(poses.t, 0.1 * np.arange(FRAMES))
    # The pusher closes the gap, then the cube moves with it. A step of the physics is 0.4 mm of its way.
    way = np.maximum(SPEED * poses.t - GAP, 0.0)
    np.testing.assert_allclose(poses.p_WO, np.stack([way, 0 * way, SIDE / 2 + 0 * way], -1), atol=0.5e-3)
    np.testing.assert_allclose(np.abs(poses.q_WO[:, 0]), 1.0, atol=1e-4)
    lines = output.splitlines()
    assert lines[0].startswith("cube, episode 0000: 5 frames in 0.40 s; moves by 3")
    assert lines[1].startswith("score against object_poses.csv (5 frames): position 0.")
    assert lines[2] == f"wrote {out}"
    assert sorted(path.name for path in out.parent.iterdir()) == ["poses.csv", "poses.predict.config.yaml"]


def test_an_episode_without_truth_has_no_score(pinwm, folder, tmp_path):
    arguments = [str(folder / "twin"), str(folder / "capture/episodes/second"), "--out", str(tmp_path / "p.csv")]
    video, plot = tmp_path / "film.mp4", tmp_path / "motion.png"
    code, output, errors = pinwm("predict", *arguments, "--video", str(video), "--plot", str(plot))
    assert (code, errors) == (0, "")
    assert "score: none, as the episode has no object_poses.csv for these times\n" in output
    reader = cv2.VideoCapture(str(video))
    assert reader.get(cv2.CAP_PROP_FRAME_COUNT) == FRAMES
    assert reader.get(cv2.CAP_PROP_FRAME_WIDTH) % 3 == 0
    assert cv2.imread(str(plot)).shape[1] > 600


def test_another_scene_is_warned_of(pinwm, folder, tmp_path):
    shape = PusherShape("sphere", 0.02)
    write_identified(
        tmp_path / "twin", folder / "capture", pusher=PusherGeometry(None, shape), gravity=1.6, floor_height=0.01
    )
    mesh = tmp_path / "twin/meshes/object.obj"
    assert mesh.exists()
    arguments = [str(tmp_path / "twin"), str(folder / "capture/episodes/0000"), "-o", str(tmp_path / "p.csv")]
    code, _, errors = pinwm("predict", *arguments)
    assert code == 0
    warnings = errors.splitlines()
    assert [line.startswith("warning: ") for line in warnings] == [True] * 3
    assert "pusher is another one" in warnings[0]
    assert "gravity is 1.6 m/s² in the twin; the 9.81 m/s² of the capture are used" in warnings[1]
    assert "the floor is 10.0 mm high in the twin; the 0.0 mm of the capture are used" in warnings[2]
    assert read_pose_table(tmp_path / "p.csv").p_WO[:, 2] == pytest.approx(SIDE / 2, abs=1e-4)


def test_the_start_that_was_estimated_is_that_of_its_episode_only(folder):
    nuisance = {
        "start_x": Estimate(1e-3, None, True, "m"),
        "start_y": Estimate(-2e-3, None, True, "m"),
        "start_yaw": Estimate(0.2, None, True, "rad"),
        "time_offset": Estimate(0.01, None, True, "s"),
    }
    write_identified(folder / "offset", folder / "capture", nuisance=nuisance)
    twin, capture = load_twin(folder / "offset"), load_capture(folder / "capture")
    first, second = (read_episode(capture, name) for name in ("0000", "second"))
    assert identified_push(twin, capture, first) == 0
    assert identified_push(twin, capture, second) is None
    start = start_pose(twin, capture, 0)
    np.testing.assert_allclose(start.p, [1e-3, -2e-3, SIDE / 2], rtol=0, atol=1e-15)
    np.testing.assert_allclose(start.q, [np.cos(0.1), 0, 0, np.sin(0.1)], rtol=0, atol=1e-15)
    assert time_offset(twin, 0) == 0.01
    assert time_offset(twin, None) == 0.0
    assert start_pose(twin, capture, None) is capture.object.X_WO
    # An episode of the same name in another capture is another episode.
    path = write_push(folder / "other", frames=FRAMES + 1)
    other = load_capture(path)
    assert identified_push(twin, other, read_episode(other, "0000")) is None


def test_of_its_own_capture_a_twin_knows_what_the_static_views_show(folder, tmp_path):
    capture = load_capture(folder / "capture")
    twin = load_twin(folder / "twin")
    X_OS = Pose(LEVEL, torch.tensor([2e-3, 1e-3, 0.0], dtype=torch.float64))
    seen = seen_in(capture, X_OS)
    entry = registration_entry(capture.object.X_WO, seen.object.X_WO)
    knows = dataclasses.replace(twin, provenance=twin.provenance | entry)
    write_twin(tmp_path / "twin", knows)
    knows = load_twin(tmp_path / "twin")
    assert torch.allclose(seen_start(knows, capture).p, capture.object.X_WO.p + X_OS.p)
    # Another capture, with another pose, is taken at its word.
    assert seen_start(knows, seen) is seen.object.X_WO
    assert start_pose(twin, capture, None) is capture.object.X_WO
    for broken in ({"written": {}}, {"written": {"q": [1, 0], "p": ["x"]}, "seen": 3}):
        half = dataclasses.replace(twin, provenance=twin.provenance | {"start": broken})
        assert seen_start(half, capture) is capture.object.X_WO


@pytest.mark.parametrize(("name", "expected"), [("0000", 0.02), ("second", 0.0)])
def test_prediction_uses_what_was_estimated_for_its_episode_only(pinwm, folder, tmp_path, monkeypatch, name, expected):
    write_identified(
        tmp_path / "twin", folder / "capture", theta=THETA, nuisance={"start_y": Estimate(0.02, None, True, "m")}
    )
    hashed = []
    monkeypatch.setattr(origin, "hash_capture", lambda *arguments: hashed.append(arguments) or hash_capture(*arguments))
    out = tmp_path / "p.csv"
    arguments = [str(tmp_path / "twin"), str(folder / "capture/episodes" / name), "-o", str(out)]
    code, _, errors = pinwm("predict", *arguments, "--video", str(tmp_path / "film.mp4"))
    assert (code, errors) == (0, "")
    assert read_pose_table(out).p_WO[0, 1] == pytest.approx(expected, abs=1e-12)
    # All files of a capture are read for that: not more than once.
    assert len(hashed) <= 1


def test_wrong_input_is_one_line_and_exit_with_1(pinwm, folder, tmp_path):
    twin, episode = str(folder / "twin"), folder / "capture/episodes/0000"
    out = ["-o", str(tmp_path / "p.csv")]
    kept = (episode / "object_poses.csv").read_bytes()
    for arguments, message in (
        ([twin, str(episode), *out, "--video", "a.avi"], "--video: got a.avi; allowed: a name that ends in .mp4"),
        ([twin, str(episode), "-o", str(tmp_path)], f"{tmp_path}: got a folder; allowed: a file"),
        ([twin, str(episode), "-o", str(episode / "object_poses.csv")], "object_poses.csv: got a file of the episode"),
        ([twin, str(folder / "capture"), *out], "allowed: CAPTURE/episodes/NAME"),
        ([twin, str(folder / "capture/episodes/none"), *out], "no episode 'none'"),
        ([str(folder / "capture"), str(episode), *out], "twin.yaml: no such file"),
    ):
        code, output, errors = pinwm("predict", *arguments)
        assert (code, output, errors.count("\n")) == (1, "", 1)
        assert message in errors
    assert not (tmp_path / "p.csv").exists()
    assert (episode / "object_poses.csv").read_bytes() == kept
