# SPDX-License-Identifier: MIT
"""Commands where the root is read-only, the user has no name and no home, and the terminal has ASCII only."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from pinwm_drake.cli.app import _told
from pinwm_drake.errors import InputError, PinwmError
from tests.capture.pushed_cube import write_pushed_cube
from tests.cli.evaluations import write_scenario
from tests.containers import ROOT, run
from tests.identification.samples import write_appearance, write_capture

WARNING = "set NUMBA_CACHE_DIR to a folder that lasts"
ELSEWHERE = "NUMBA_CACHE_DIR" in os.environ


def test_a_capture_is_checked_in_a_container(pinwm, tmp_path):
    write_pushed_cube(tmp_path / "capture")
    assert pinwm("capture", "check", str(tmp_path / "capture"))[0] == 0  # and kernels are compiled
    done = run(tmp_path, "capture", "check", "capture", PYTHONIOENCODING="ascii")
    assert done.returncode == 0, done.stderr
    assert " 0 errors, " in done.stdout
    # Kernels that were compiled beside the sources are taken along; those in a folder elsewhere are compiled anew.
    told = [line for line in done.stderr.splitlines() if not (ELSEWHERE and line.endswith("cached afterwards"))]
    assert [line.endswith(WARNING) for line in told] == [True]
    (kernels,) = tmp_path.glob("pinwm-kernels-*")
    assert kernels.stat().st_mode & 0o77 == 0


@pytest.mark.nightly
def test_a_twin_rolls_out_in_a_container(pinwm, tmp_path):
    scene = write_scenario(tmp_path)
    options = ("--engine", "twin", "--duration", "0.1", "-o")
    assert pinwm("simulate", scene, *options, str(tmp_path / "here"))[0] == 0
    done = run(tmp_path, "simulate", scene, *options, "there", PYTHONIOENCODING="ascii")
    assert done.returncode == 0, done.stderr
    poses = [(tmp_path / name / "object_poses.csv").read_text() for name in ("here", "there")]
    assert poses[0] == poses[1]


@pytest.mark.nightly
@pytest.mark.parametrize("coding", ["ascii", "latin-1"])
def test_the_whole_way_in_a_container(tmp_path, coding):
    write_capture(tmp_path / "push")
    write_pushed_cube(tmp_path / "capture")
    write_appearance(tmp_path / "twin")
    scene = write_scenario(tmp_path)
    quick = ("--starts", "1", "--support", "patch", "--free", "friction_floor", "--time-step", "0.005")
    for command in (
        ("capture", "check", "capture"),
        ("identify", "push", "twin", *quick),
        ("simulate", scene, "--engine", "twin", "-o", "episode", "--duration", "0.3"),
        ("simulate", scene, "--engine", "hydroelastic", "-o", "drake", "--duration", "0.1"),
        ("control", "push_t", "--engine", "twin", "--duration", "0.3"),
    ):
        done = run(tmp_path, *command, PYTHONIOENCODING=coding)
        assert done.returncode == 0, done.stderr
        allowed = (WARNING, "cached afterwards")
        assert all(line.endswith(allowed) for line in done.stderr.splitlines()), done.stderr
    assert (tmp_path / "twin/twin.yaml").exists()
    assert not list(tmp_path.rglob(".*"))
    assert sorted(path.name for path in tmp_path.iterdir() if path.name.startswith("pinwm")) == [
        f"pinwm-kernels-{12345}"
    ]


def test_a_working_folder_that_is_gone(tmp_path):
    gone = tmp_path / "gone"
    gone.mkdir()
    script = f"import os; os.chdir({str(gone)!r}); os.rmdir({str(gone)!r})\nfrom pinwm_drake.cli import main; main()"
    here = {**os.environ, "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-c", script, "capture", "check", "/nowhere"]
    done = subprocess.run(command, env=here, capture_output=True, text=True, check=False)
    told = "pinwm: working folder: no such folder; allowed: a folder that is there; cd to one\n"
    assert (done.returncode, done.stderr) == (1, told)


def test_a_limit_of_memory_is_told_in_one_line():
    script = "import resource; resource.setrlimit(resource.RLIMIT_AS, (5 * 10**8, 5 * 10**8))\n"
    script += "from pinwm_drake.cli import main; main()"
    command = [sys.executable, "-c", script, "capture", "check", "t_block"]
    here = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(command, env=here, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert done.stderr.startswith("pinwm: memory: got too little")
    assert "allowed: a machine or container with more memory" in done.stderr
    assert done.stderr.count("\n") == 1


def test_a_name_that_no_file_can_have_is_one_line():
    with pytest.raises(InputError, match=r"a{50}: got File name too long; allowed: a shorter name"), _told():
        Path(300 * "a").stat()


@pytest.mark.parametrize("error", [MemoryError(), RuntimeError("DefaultCPUAllocator: can't allocate memory: 1 byte")])
def test_want_of_memory_is_an_error_of_the_family(error):
    with pytest.raises(PinwmError, match="memory: got too little"), _told():
        raise error


@pytest.mark.parametrize("error", [RuntimeError("another"), OSError("no such file"), InputError("a", allowed="b")])
def test_other_errors_stay_what_they_are(error):
    with pytest.raises(type(error)) as found, _told():
        raise error
    assert found.value is error
