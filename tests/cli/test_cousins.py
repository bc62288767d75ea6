# SPDX-License-Identifier: MIT
from pathlib import Path

import cv2
import pytest

from pinwm_drake.cousins.cousin import draw_cousins
from pinwm_drake.cousins.io import read_cousins
from pinwm_drake.twin.read import load_twin
from pinwm_drake.twin.write import write_twin
from tests.twin.samples import cube_twin


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("twin")
    write_twin(path / "twin", cube_twin(path))
    return path / "twin"


def test_cousins_are_written_with_their_sheet(pinwm, folder, tmp_path):
    out = tmp_path / "new/out"
    options = ["--number", "3", "--delta", "0.2", "--seed", "5"]
    code, output, errors = pinwm("cousins", str(folder), "-o", str(out), *options)
    assert (code, errors) == (0, "")
    assert sorted(path.name for path in out.iterdir()) == ["cousins.config.yaml", "cousins.npz", "cousins.png"]
    twin = load_twin(folder)
    found, expected = read_cousins(out / "cousins.npz", twin), draw_cousins(twin, 3, 0.2, seed=5)
    assert [one.theta for one in found.members] == [one.theta for one in expected.members]
    assert cv2.imread(str(out / "cousins.png")).std() > 10
    lines = output.splitlines()
    assert lines[1].split() == ["mass", "0.2", "0.16", "0.24", "kg", "delta"]
    assert lines[-3].endswith("% of the colours were kept back to be displayable")
    assert lines[-2:] == [f"wrote {out / 'cousins.npz'}", f"wrote {out / 'cousins.png'}"]


def test_intervals_are_named(pinwm, folder, tmp_path):
    code, output, _ = pinwm("cousins", str(folder), "-o", str(tmp_path), "--number", "1", "--from-intervals")
    assert code == 0
    assert output.splitlines()[5].split() == ["friction_floor", "0.3", "0.27", "0.33", "interval"]
    assert read_cousins(tmp_path / "cousins.npz", load_twin(folder)).draw.from_intervals


def test_wrong_input_is_one_line_and_exit_with_1(pinwm, folder, tmp_path):
    out = tmp_path / "out"
    for arguments, message in (
        ([str(folder), "--number", "0"], "--number: got 0; allowed: 1 to 200"),
        ([str(folder), "--number", "201"], "--number: got 201; allowed: 1 to 200"),
        ([str(folder), "--delta", "1"], "--delta: got 1.0; allowed: 0 or more, less than 1"),
        ([str(folder), "--seed", "-1"], "--seed: got -1; allowed: 0 or more"),
        (
            [str(tmp_path)],
            f"{tmp_path / 'twin.yaml'}: no such file; allowed: the twin that `pinwm identify` writes",
        ),
    ):
        assert pinwm("cousins", *arguments, "-o", str(out)) == (1, "", f"pinwm: {message}\n")
    assert not out.exists()
    (tmp_path / "file").write_text("")
    code, _, errors = pinwm("cousins", str(folder), "-o", str(tmp_path / "file"))
    assert (code, errors.count("\n")) == (1, 1)
