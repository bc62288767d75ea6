# SPDX-License-Identifier: MIT
import math
import signal
import subprocess
import sys
import time
from pathlib import Path

import cv2
import pytest

from pinwm_drake.experiments.evaluation.episodes import run_episodes
from tests.cli.evaluations import document, rows, write_scenario

ROOT = Path(__file__).parents[2]
SHORT = ["--engine", "twin", "--episodes", "3", "--max-steps", "4", "--workers", "1"]


@pytest.fixture(scope="module")
def scenario(tmp_path_factory) -> str:
    return write_scenario(tmp_path_factory.mktemp("scenario"))


@pytest.fixture(scope="module")
def evaluated(pinwm, scenario, tmp_path_factory) -> Path:
    """What one process makes of it, in three episodes."""
    out = tmp_path_factory.mktemp("evaluate") / "new/out"
    code, output, errors = pinwm("evaluate", "random", *SHORT, "--scene", scenario, "--seed", "5", "-o", str(out))
    assert (code, errors) == (0, "")
    (out.parent / "output.txt").write_text(output)
    return out


def test_what_it_writes(evaluated):
    names = ["episodes", "episodes.csv", "episodes.mp4", "evaluate.config.yaml", "evaluation.json", "report.html"]
    assert sorted(path.name for path in evaluated.iterdir()) == names
    table, found = rows(evaluated), document(evaluated)
    assert [row["seed"] for row in table] == ["5", "6", "7"]
    won = sum(int(row["success"]) for row in table)
    assert found["results"]["successes"] == won
    assert found["results"]["episodes"] == 3
    assert found["seeds"] == [5, 7]
    settings = found["settings"]
    assert (settings["policy"], settings["engine"], settings["task.tolerance"], settings["max_steps"]) == (
        *("random", "twin", 0.02, 4),
    )
    assert set(found["provenance"]["versions"]) >= {"pinwm_drake", "drake", "torch", "python"}
    for row in table:
        assert math.hypot(float(row["start_x"]), float(row["start_y"])) == pytest.approx(float(row["start_distance"]))
        assert abs(float(row["start_yaw"])) == pytest.approx(float(row["start_angle"]), abs=1e-9)
        assert abs(float(row["start_yaw"])) <= 0.3
        assert row["failure"] == ""
    output = (evaluated.parent / "output.txt").read_text()
    assert f"{won} of 3 episodes succeeded" in output
    assert f"wrote {evaluated / 'report.html'}" in output
    assert f"{won} of 3 episodes succeeded" in (evaluated / "report.html").read_text()
    longest = max(int(row["steps"]) for row in table)
    reader = cv2.VideoCapture(str(evaluated / "episodes.mp4"))
    assert reader.get(cv2.CAP_PROP_FRAME_COUNT) == longest + 1 + 8
    assert reader.get(cv2.CAP_PROP_FPS) == pytest.approx(10)


@pytest.mark.nightly
def test_a_run_of_two_processes_that_was_killed_goes_on_in_one_to_the_same_result(pinwm, scenario, tmp_path, evaluated):
    out, episodes = tmp_path / "out", tmp_path / "out/episodes"
    command = [sys.executable, "-c", "from pinwm_drake.cli import main; main()", "evaluate", "random"]
    options = [*SHORT[:-1], "2", "--scene", scenario, "--seed", "5", "-o", str(out)]
    process = subprocess.Popen([*command, *options], cwd=ROOT, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    while not list(episodes.glob("0*.npz")) and process.poll() is None:
        time.sleep(0.01)
    workers = children(process.pid)
    process.send_signal(signal.SIGKILL)
    process.wait()
    assert process.returncode == -signal.SIGKILL
    assert len(workers) >= 2
    deadline = time.monotonic() + 60
    while any(running(worker) for worker in workers):
        assert time.monotonic() < deadline, "workers outlive the process that started them"
        time.sleep(0.05)
    code, output, errors = pinwm("evaluate", "random", *options, "--workers", "1", "--resume")
    assert code == 0, errors
    assert "of 3 episodes are done already" in output
    assert (out / "episodes.csv").read_bytes() == (evaluated / "episodes.csv").read_bytes()
    assert document(out)["results"] == document(evaluated)["results"]
    assert (out / "report.html").exists()


def children(pid: int) -> list[int]:
    """Processes that a process has started."""
    found = []
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = path.read_text().rpartition(")")[2].split()
        except OSError:
            continue
        if int(fields[1]) == pid:
            found.append(int(path.parent.name))
    return found


def running(pid: int) -> bool:
    """Whether a process is there and has not ended; those of a killed process may not be waited for by anyone."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def test_resuming_asks_for_the_same_settings(pinwm, scenario, evaluated):
    base = ["evaluate", "random", "--scene", scenario, "--seed", "5", *SHORT, "-o", str(evaluated)]
    code, _, errors = pinwm(*base)
    assert code == 1
    assert "got episodes of an evaluation; allowed: a new folder, or --resume" in errors
    code, _, errors = pinwm(*base, "--resume", "--tolerance", "0.01")
    assert code == 1
    assert "got a test with task.tolerance = 0.02; allowed: one with task.tolerance = 0.01" in errors
    code, _, errors = pinwm(*base, "--resume", "--yaw", "0.2")
    assert code == 1
    assert "scene_sha256" in errors


def test_an_evaluation_can_be_made_longer(pinwm, scenario, tmp_path, evaluated):
    base = ["evaluate", "random", "--scene", scenario, *SHORT, "-o", str(tmp_path)]
    assert pinwm(*base, "--seed", "5", "--episodes", "1")[0] == 0
    assert len(rows(tmp_path)) == 1
    kept = (tmp_path / "episodes/000005.npz").stat().st_mtime_ns
    code, output, _ = pinwm(*base, "--seed", "5", "--episodes", "3", "--resume")
    assert code == 0
    assert "1 of 3 episodes are done already" in output
    assert (tmp_path / "episodes/000005.npz").stat().st_mtime_ns == kept
    assert (tmp_path / "episodes.csv").read_bytes() == (evaluated / "episodes.csv").read_bytes()
    assert len(list((tmp_path / "episodes").iterdir())) == 3


def test_an_interrupted_run_says_how_to_go_on(pinwm, scenario, tmp_path, monkeypatch, evaluated):
    base = ["evaluate", "random", "--scene", scenario, "--seed", "5", *SHORT, "-o", str(tmp_path)]

    def at_once(*arguments, **options):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr("pinwm_drake.experiments.evaluation.run.run_episodes", at_once)
        code, output, _ = pinwm(*base)
    assert (code, output.splitlines()[-1]) == (1, "interrupted after 0 episodes")

    def interrupted(runner, request, seeds, store, executor, *, on_result):
        run_episodes(runner, request, seeds[:2], store, executor, on_result=on_result)
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr("pinwm_drake.experiments.evaluation.run.run_episodes", interrupted)
        code, output, _ = pinwm(*base)
    assert code == 1
    assert "interrupted after 2 episodes; go on with --resume" in output
    assert not (tmp_path / "evaluation.json").exists()
    assert pinwm(*base, "--resume")[0] == 0
    assert (tmp_path / "episodes.csv").read_bytes() == (evaluated / "episodes.csv").read_bytes()
