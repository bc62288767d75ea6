# SPDX-License-Identifier: MIT
from pinwm_drake.guide.lab import LabFolder
from tests.guide.test_guide import BOX, TOOL, fill_in


def test_a_new_lab_and_its_guide(pinwm, tmp_path):
    folder = tmp_path / "mylab"
    code, said, errors = pinwm("lab", "new", str(folder))
    assert code == 0, errors
    assert "next (act 1 of 11): Print board.pdf at 100 %" in said
    code, said, errors = pinwm("lab", str(folder))
    assert code == 0, errors
    assert "Board and settings: missing" in said
    assert f"wrote {folder}/lab.html" in said
    assert "next (act 1 of 11): Print board.pdf" in said
    code, _, errors = pinwm("lab", "new", str(folder))
    assert code == 1
    assert "something there already" in errors


def test_options_may_come_first_and_a_refused_file_ends_with_1(pinwm, tmp_path):
    folder = tmp_path / "mylab"
    pinwm("lab", "new", str(folder))
    fill_in(LabFolder(folder), ruler=0.3, workspace=BOX, tool=TOOL)
    code, said, errors = pinwm("lab", "--no-run", str(folder))
    assert code == 1
    assert "ruler" in errors
    assert "Mend what is refused" in said


def test_a_folder_called_new_is_written_with_a_dot(pinwm, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert pinwm("lab", "new", "new")[0] == 0
    assert "act 1 of 11" in pinwm("lab", "./new")[1]
    code, _, errors = pinwm("lab", "elsewhere")
    assert code == 1
    assert "no lab; allowed: a lab's folder; pinwm lab new elsewhere makes one" in errors
