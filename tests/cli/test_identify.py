# SPDX-License-Identifier: MIT
import shutil

import cv2
import numpy as np
import pytest

from pinwm_drake import documents
from pinwm_drake.capture.episode_tables import read_pose_table
from pinwm_drake.identification import search
from pinwm_drake.identification.history import read_history
from pinwm_drake.identification.sampling import sample
from pinwm_drake.identification.search import Search
from pinwm_drake.identification.unknowns import DEFAULT_FREE
from pinwm_drake.twin.read import load_twin
from pinwm_drake.twin.words import doubt_words
from tests.identification.samples import FRAMES, TRUTH, write_appearance, write_capture


@pytest.fixture(scope="module")
def capture(tmp_path_factory):
    return write_capture(tmp_path_factory.mktemp("cli_identify") / "capture")


@pytest.fixture(scope="module")
def twin(tmp_path_factory):
    folder = tmp_path_factory.mktemp("twin") / "twin"
    write_appearance(folder)
    return folder


# The kernels of the other tests.
QUICK = ("--starts", "2", "--support", "patch", "--threads", "2")


def test_a_capture_becomes_a_twin(pinwm, capture, twin, monkeypatch):
    monkeypatch.setattr(search, "sample", lambda *given, moves, **options: sample(*given, moves=6, **options))
    code, output, errors = pinwm("identify", str(capture), str(twin), *QUICK, "--starts", "1")
    assert (code, errors) == (0, "")
    assert "friction_floor" in output
    assert "score against object_poses.csv, which was not used" in output.replace("\n", " ")
    read = load_twin(twin)
    assert read.theta["friction_floor"].value == pytest.approx(TRUTH["friction_floor"], rel=0.05)
    assert read.support == "patch"
    assert read.provenance["episode"] == "0000"
    assert read.provenance["command"].startswith("pinwm identify")
    assert read_pose_table(twin / "episodes/0000.csv").t.tolist() == pytest.approx([k / 20 for k in range(FRAMES)])
    history = read_history(twin / "history.npz")
    assert "friction_floor" in history.names
    assert not (twin / "identify_checkpoint.npz").exists()
    # The twin does again what it was identified from.
    code, output, errors = pinwm(
        "predict", str(twin), str(capture / "episodes/0000"), "-o", str(twin.parent / "poses.csv")
    )
    assert (code, errors) == (0, "")
    predicted, found = read_pose_table(twin.parent / "poses.csv"), read_pose_table(twin / "episodes/0000.csv")
    assert abs(predicted.p_WO - found.p_WO).max() < 1e-4


def test_images_that_are_explained_badly_are_told():
    assert doubt_words(0.0021) == doubt_words(float("nan")) == ""
    assert doubt_words(0.0195).startswith("the images are explained badly (loss 0.0195")
    assert doubt_words(0.0195).endswith("--time-step")


@pytest.mark.nightly
def test_one_unknown_alone(pinwm, capture, tmp_path):
    write_appearance(tmp_path)
    arguments = ("--free", "friction_floor", "--hold", "friction_pusher=0.3", "--time-step", "0.005")
    code, output, errors = pinwm("identify", str(capture), str(tmp_path), *QUICK, *arguments, "--view")
    assert (code, errors) == (0, "")
    read = load_twin(tmp_path)
    theta = read.theta
    # A page showed the search while it went on.
    page = (tmp_path / "progress.html").read_text()
    assert f"open {tmp_path / 'progress.html'} in a browser" in output
    assert "refresh" not in page
    assert "Identification of cube" in page
    picture = cv2.imread(str(tmp_path / "progress.png"))
    pictures = picture[:, picture.shape[1] // 2 :]
    assert np.ptp(pictures.astype(int), axis=2).max() > 60, "there is no picture in colours"
    assert read.time_step == 0.005
    # Where and when the push began is free, too: half of the interval is 12 % wide.
    assert theta["friction_floor"].value == pytest.approx(TRUTH["friction_floor"], rel=0.1)
    low, high = theta["friction_floor"].interval
    assert low < TRUTH["friction_floor"] < high
    assert theta["friction_pusher"].value == 0.3
    assert theta["friction_pusher"].interval is None


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--free", "colour"), "--free: got 'colour'"),
        (("--hold", "mass"), "--hold: got 'mass'; allowed: NAME=VALUE"),
        (("--hold", "mass=heavy"), "--hold: got 'mass=heavy'"),
        (("--without", "gravity"), "--without: got 'gravity'"),
        (tuple(f"--without={name}" for name in DEFAULT_FREE), "none is left to find"),
        (("--support", "edges"), "--support: got 'edges'"),
        (("--starts", "0"), "--starts: got 0"),
        (("--time-step", "0.2"), "--time-step: got 0.2; allowed: 1e-05 to 0.1"),
        (("--episode", "0007"), "no episode '0007'"),
    ],
)
def test_nonsense_is_refused(pinwm, capture, tmp_path, arguments, words):
    write_appearance(tmp_path)
    code, _, errors = pinwm("identify", str(capture), str(tmp_path), *arguments)
    assert code == 1
    assert words in errors.replace("\n", " ")


def test_directions_are_accepted_with_a_warning(pinwm, capture, tmp_path, monkeypatch):
    monkeypatch.setattr(documents, "_warned", set())
    write_appearance(tmp_path)
    code, _, errors = pinwm("identify", str(capture), str(tmp_path), "--directions", "8", "--episode", "0007")
    assert code == 1
    assert errors.startswith("warning: pinwm identify: --directions has no effect")
    assert "no episode '0007'" in errors


def test_a_capture_without_a_push_is_refused(pinwm, capture, tmp_path):
    lone = tmp_path / "capture"
    shutil.copytree(capture, lone, ignore=shutil.ignore_patterns("episodes"))
    code, _, errors = pinwm("identify", str(lone), str(tmp_path / "twin"))
    assert code == 1
    assert "no folder in episodes/" in errors


@pytest.mark.nightly
def test_ctrl_c_keeps_what_was_done(pinwm, capture, tmp_path, monkeypatch):
    write_appearance(tmp_path)
    original = Search._fine

    def interrupted(self, *arguments):
        raise KeyboardInterrupt

    monkeypatch.setattr(Search, "_fine", interrupted)
    code, output, _ = pinwm("identify", str(capture), str(tmp_path), *QUICK)
    assert code == 1
    assert "go on with --resume" in output
    monkeypatch.setattr(Search, "_fine", original)
    code, _, errors = pinwm("identify", str(capture), str(tmp_path), *QUICK, "--resume")
    assert (code, errors) == (0, "")
    assert load_twin(tmp_path).theta["friction_floor"].value == pytest.approx(TRUTH["friction_floor"], rel=0.05)
