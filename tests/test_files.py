# SPDX-License-Identifier: MIT
import os

import pytest

from pinwm_drake.errors import InputError
from pinwm_drake.files import appearing, prepare_folder, replacing


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
