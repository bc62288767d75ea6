# SPDX-License-Identifier: MIT
import math
import os
import re
import signal
import subprocess
import sys
import time
from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

from pinwm_drake.cli.app import app
from pinwm_drake.cli.train import _reporter
from pinwm_drake.errors import InputError
from pinwm_drake.experiments.training import can_go_on
from pinwm_drake.learning.policy import read_policy
from pinwm_drake.learning.progress import Step
from pinwm_drake.systems.envs.training_worlds import TrainingWorlds, training_options

pytestmark = pytest.mark.usefixtures("read_operators_once")

SHORT = ["--worlds", "4", "--image-size", "32", "--threads", "1", "--episodes", "4"]
CLOSER = ["--tolerance", 0.01, "--turn-tolerance", 0.1]
TINY = ["--images", "200", "--updates", "10"]


def train(*arguments):
    return CliRunner().invoke(app, ["train", *map(str, arguments)])


def weights(folder):
    with np.load(folder / "weights.npz") as file:
        return {name: file[name] for name in file.files if name != "about"}


@pytest.fixture(scope="module")
def teacher(tmp_path_factory):
    """Folder of a brief training, and what it printed."""
    run = tmp_path_factory.mktemp("teacher") / "run"
    out = train("push_t", "-o", run, "--method", "state", "--steps", 512, *CLOSER, *SHORT)
    assert out.exit_code == 0, out.output
    return run, out.output


def test_a_teacher_is_trained_and_kept(teacher):
    run, output = teacher
    # Not a terminal: plain lines, of the beginning, of rollouts and of the round.
    lines = [line for line in output.splitlines() if line.startswith("teacher ")]
    assert lines[0] == "teacher   0%  getting ready  -:--:-- left"
    assert re.search(r"teacher 100%  512 steps  \d+ steps/s  loss .* success \d+% in \d+ actions, best", lines[-1])
    assert re.search(r"\d:\d\d:\d\d taken$", lines[-1])
    policy = read_policy(run)
    assert policy.spec.observes == "state"
    assert policy.provenance["trained_in"]["delta"] == 0.1
    assert policy.provenance["seed"] == 0
    assert policy.provenance["home"] == {"scene": "push_t"}
    assert (run / "training.png").stat().st_size > 1000
    assert list((run / "teacher" / "tensorboard").iterdir())
    # What it acts in is what it was trained in.
    worlds = TrainingWorlds(
        "push_t", training_options(image_size=32, task={"tolerance": 0.01, "turn_tolerance": 0.1}), num_worlds=4
    )
    assert replace(worlds.spec("state"), head="dither", width=128) == policy.spec


def test_a_student_learns_from_a_given_teacher(teacher, tmp_path):
    out = train("push_t", "-o", tmp_path / "s", "--teacher", teacher[0], "--rounds", 1, *TINY, *CLOSER, *SHORT)
    assert out.exit_code == 0, out.output
    policy = read_policy(tmp_path / "s")
    assert policy.spec.observes == "rgb"
    assert policy.spec.image_shape == (32, 32, 9)
    again = train("push_t", "-o", tmp_path / "s2", "--teacher", tmp_path / "s", *SHORT)
    assert again.exit_code != 0
    assert isinstance(again.exception, InputError)


@pytest.mark.nightly
def test_a_run_that_was_killed_goes_on_with_the_same_result(tmp_path):
    arguments = ["push_t", "--method", "state", "--steps", "768", "--round-steps", "256", *SHORT]
    assert train(*arguments, "-o", tmp_path / "whole").exit_code == 0
    command = [sys.executable, "-c", "from pinwm_drake.cli import main; main()", "train", *arguments]
    command += ["-o", str(tmp_path / "killed")]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    table = tmp_path / "killed" / "teacher" / "history.csv"
    deadline = time.monotonic() + 300
    while not table.exists() and process.poll() is None and time.monotonic() < deadline:
        time.sleep(0.02)
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    assert table.exists()
    refused = train(*arguments, "-o", tmp_path / "killed")
    assert isinstance(refused.exception, InputError)
    assert "--resume" in str(refused.exception)
    assert train(*arguments, "-o", tmp_path / "killed", "--resume").exit_code == 0
    whole, rest = weights(tmp_path / "whole"), weights(tmp_path / "killed")
    assert all(np.array_equal(whole[name], rest[name]) for name in whole)


def test_an_interrupted_run_names_resume_only_where_something_is_kept(tmp_path, monkeypatch):
    def interrupt(*arguments, **options):
        raise KeyboardInterrupt

    monkeypatch.setattr("pinwm_drake.experiments.forecast.forecast", interrupt)
    out = train("push_t", "-o", tmp_path / "run", "--method", "state", *SHORT)
    assert (out.exit_code, out.output.splitlines()[-1]) == (1, "interrupted; nothing is kept")
    assert not can_go_on(tmp_path / "run")
    (tmp_path / "run/teacher").mkdir(parents=True)
    assert not can_go_on(tmp_path / "run")
    (tmp_path / "run/teacher/round.npz").touch()
    assert can_go_on(tmp_path / "run")
    out = train("push_t", "-o", tmp_path / "run", "--method", "state", *SHORT)
    words = f"interrupted; go on with --resume (what is done is in {tmp_path / 'run'})"
    assert (out.exit_code, out.output.splitlines()[-1]) == (1, words)


@pytest.mark.parametrize(("share", "told"), [(0.02, True), (0.3, False), (None, False)])
def test_plans_that_hardly_ever_work_are_told(share, told, capsys):
    report = _reporter(lambda *given, **more: None)
    teacher = Step("teacher", 0.1, 0, math.nan, math.nan, math.nan, math.nan, 1.0)
    if share is not None:
        report(replace(teacher, stage="waypoints", best=share))
    report(teacher)
    report(teacher)
    assert capsys.readouterr().out.count("expect a poor policy; friction at pusher or floor may be too low") == told
