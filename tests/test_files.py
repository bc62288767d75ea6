# SPDX-License-Identifier: MIT
import os
import re
import socket
import subprocess
import sys
import tempfile

import pytest

from pinwm_drake import files
from pinwm_drake.errors import InputError
from pinwm_drake.files import appearing, occupying, prepare_folder, replacing, scratch


def test_a_file_appears_whole(tmp_path):
    path = tmp_path / "a.csv"
    with replacing(path) as temporary:
        assert temporary.suffix == ".csv"
        temporary.write_text("whole")
        assert not path.exists()
    assert path.read_text() == "whole"
    assert os.listdir(tmp_path) == ["a.csv"]


def test_a_failure_leaves_the_earlier_file(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("earlier")

    def write_half() -> None:
        with replacing(path) as temporary:
            temporary.write_text("half")
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        write_half()
    assert path.read_text() == "earlier"
    assert os.listdir(tmp_path) == ["a.csv"]


def test_folders_are_made_with_their_parents(tmp_path):
    assert prepare_folder(tmp_path / "a/b").is_dir()
    assert os.listdir(tmp_path / "a/b") == []


@pytest.mark.parametrize("under", ["file", "file/below"])
def test_a_folder_that_cannot_be_is_refused(tmp_path, under):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="allowed: a folder that can be written to"):
        prepare_folder(tmp_path / under)


def test_a_file_that_cannot_be_written_is_refused(tmp_path):
    with (
        pytest.raises(InputError, match=r"a\.csv: no such file or directory"),
        replacing(tmp_path / "missing/a.csv") as temporary,
    ):
        temporary.write_text("")


@pytest.mark.parametrize("there", [False, True])
def test_a_folder_appears_whole(tmp_path, there):
    out = tmp_path / "new/out"
    if there:
        out.mkdir(parents=True)
    with appearing(out) as folder:
        (folder / "a.csv").write_text("whole")
        assert not (out / "a.csv").exists()
    assert (out / "a.csv").read_text() == "whole"
    assert os.listdir(out.parent) == ["out"]


def test_a_failure_leaves_no_folder(tmp_path):
    def write_half() -> None:
        with appearing(tmp_path / "out") as folder:
            (folder / "a.csv").write_text("half")
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        write_half()
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("kind", ["file", "full", "link", "broken link"])
def test_a_folder_takes_the_place_of_nothing(tmp_path, kind):
    out, empty = tmp_path / "out", tmp_path / "empty"
    if kind == "file":
        out.write_text("")
    elif kind == "full":
        out.mkdir()
        (out / "mine").write_text("")
    else:
        out.symlink_to(empty)
        if kind == "link":
            empty.mkdir()
    before = sorted(os.listdir(tmp_path))
    with pytest.raises(InputError, match="something there already; allowed: a new or empty folder"), appearing(out):
        pass
    assert sorted(os.listdir(tmp_path)) == before


def test_a_folder_that_fills_meanwhile_is_left_alone(tmp_path):
    out = tmp_path / "out"

    def write_late() -> None:
        with appearing(out):
            out.mkdir()
            (out / "mine").write_text("kept")

    with pytest.raises(InputError, match="allowed: a new or empty folder"):
        write_late()
    assert os.listdir(tmp_path) == ["out"]
    assert os.listdir(out) == ["mine"]


def test_a_folder_under_a_file_is_refused(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="allowed: a folder that can be written to"), appearing(tmp_path / "file/out"):
        pass


@pytest.fixture
def dead():
    """Number of a process that has ended."""
    with subprocess.Popen(["true"]) as process:
        pass
    return process.pid


@pytest.fixture
def anew(monkeypatch):
    """A process that has not looked for leftovers yet."""
    monkeypatch.setattr(files, "_swept", set())


def named(folder, process, host=None):
    """Temporary names of a file and a folder, as a process has them."""
    parts = f"~{host or files._host()}~{process}~0123abcd"
    return folder / f".a.b{parts}.csv", folder / f".out{parts}"


@pytest.mark.usefixtures("anew")
@pytest.mark.parametrize("step", ["prepare", "replace", "appear"])
def test_what_the_dead_left_goes_and_nothing_else(tmp_path, dead, step):
    gone = named(tmp_path, dead)
    mine = [".a~x~csv", ".a.123.csv", f"a~{files._host()}~{dead}~0123abcd.csv", f"~{files._host()}~{dead}~0123abcd"]
    kept = [*named(tmp_path, os.getpid()), *named(tmp_path, 1), *named(tmp_path, dead, "elsewhere_effffffc")]
    kept += [tmp_path / name for name in mine]
    for path in (*gone, *kept):
        if path.suffix == ".csv" or path.name in mine:
            path.write_text("")
        else:
            path.mkdir()
            (path / "inner").write_text("")
    if step == "prepare":
        prepare_folder(tmp_path)
    elif step == "replace":
        with replacing(tmp_path / "new") as temporary:
            temporary.write_text("")
    else:
        with appearing(tmp_path / "new"):
            pass
    assert sorted(path for path in tmp_path.iterdir() if path.name != "new") == sorted(kept)


@pytest.mark.usefixtures("anew")
def test_a_killed_process_leaves_nothing_after_the_next_run(tmp_path):
    script = (
        "import os, signal, sys; from pathlib import Path\n"
        "from pinwm_drake.files import appearing, occupying, replacing, scratch\n"
        "folder = Path(sys.argv[1]); models = scratch()\n"
        "with occupying(folder), appearing(folder / 'b') as b, replacing(folder / ('x' * 240 + '.csv')) as path:\n"
        "    path.write_text('half'); (b / 'c').write_text(''); os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    here = {**os.environ, "TMPDIR": str(tmp_path)}
    assert subprocess.run([sys.executable, "-c", script, tmp_path], env=here, check=False).returncode == -9
    assert len(os.listdir(tmp_path)) == 4  # lock, file, folder, folder for temporary files
    with occupying(tmp_path):
        assert os.listdir(tmp_path) == [files.LOCK_FILE]
    assert os.listdir(tmp_path) == []


def test_two_threads_do_not_share_a_temporary_name(tmp_path):
    with replacing(tmp_path / "a") as one, replacing(tmp_path / "a") as other:
        one.write_text("1")
        other.write_text("2")
    assert (tmp_path / "a").read_text() == "1"


def test_a_second_run_in_a_folder_names_the_first(tmp_path):
    script = (
        "import sys; from pathlib import Path; from pinwm_drake.files import occupying\n"
        "with occupying(Path(sys.argv[1])):\n    print('in', flush=True); sys.stdin.read()\n"
    )
    with subprocess.Popen(
        [sys.executable, "-c", script, tmp_path], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as first:
        assert first.stdout.readline() == b"in\n"
        for _ in range(2):
            with pytest.raises(InputError) as refused, occupying(tmp_path):
                pass
            wanted = (
                rf"{tmp_path}: got a run at work in it \(process {first.pid} on {socket.gethostname()}\S*\); allowed: "
            )
            assert re.match(wanted, str(refused.value))
        first.stdin.close()
    with occupying(tmp_path), occupying(tmp_path):  # a run within a run
        assert os.listdir(tmp_path) == [files.LOCK_FILE]
    assert os.listdir(tmp_path) == []


def test_a_folder_for_temporary_files_goes_with_its_owner(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    with scratch() as folder:
        assert os.listdir(tmp_path) == [os.path.basename(folder)]
    assert os.listdir(tmp_path) == []
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "none"))
    with pytest.raises(InputError, match="TMPDIR"):
        scratch()
