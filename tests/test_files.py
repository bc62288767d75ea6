import os

import pytest

from pinwm_drake.errors import InputError
from pinwm_drake.files import prepare_folder, replacing


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
        pytest.raises(InputError, match=r"a\.csv: got No such file or directory"),
        replacing(tmp_path / "missing/a.csv") as temporary,
    ):
        temporary.write_text("")
