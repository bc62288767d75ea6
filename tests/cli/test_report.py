# SPDX-License-Identifier: MIT
from pathlib import Path

import pytest

from tests.report.samples import write_identified, write_push


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("push")
    write_push(path / "capture", frames=2)
    write_identified(path / "twin", path / "capture")
    return path


def test_a_report_is_written_beside_the_twin_and_elsewhere(pinwm, folder):
    code, output, errors = pinwm("report", str(folder / "twin"))
    assert (code, errors) == (0, "")
    assert "The twin reproduces the video.\n" in output
    assert "position 0.00 mm on average" in output
    assert output.endswith(f"wrote {folder / 'twin/report.html'}\n")
    code, output, errors = pinwm("report", str(folder / "twin"), "-o", str(folder / "new/a.html"))
    assert (code, errors) == (0, "")
    assert (folder / "new/a.html").read_bytes() == (folder / "twin/report.html").read_bytes()
    assert sorted(path.name for path in (folder / "new").iterdir()) == ["a.html", "a.report.config.yaml"]


def test_a_twin_can_be_viewed(pinwm, folder):
    code, output, _ = pinwm("view", str(folder / "twin"), "--html", str(folder / "view.html"))
    assert (code, output) == (0, f"wrote {folder / 'view.html'}\n")


def test_notes_go_to_standard_error(pinwm, folder, tmp_path):
    write_identified(tmp_path / "twin", folder / "capture", provenance={})
    code, output, errors = pinwm("report", str(tmp_path / "twin"))
    assert code == 0
    assert errors == "note: The twin does not say which capture it is from; --capture names it.\n"
    assert "No images at hand" in output


def test_wrong_input_is_one_line_and_exit_with_1(pinwm, folder, tmp_path):
    twin, wanted = str(folder / "twin"), "allowed: a twin, as `pinwm identify` writes it, or one of t_block"
    (tmp_path / "a.html").mkdir()
    for arguments, message in (
        ([twin, "-o", "a.pdf"], "--out: got a.pdf; allowed: a name that ends in .html or .htm"),
        ([twin, "-o", str(tmp_path / "a.html")], f"{tmp_path / 'a.html'}: got a folder; allowed: a file"),
        (
            [str(tmp_path / "no")],
            f"{tmp_path / 'no'}: no such folder; {wanted}",
        ),
    ):
        assert pinwm("report", *arguments) == (1, "", f"pinwm: {message}\n")
    code, output, errors = pinwm("report", twin, "--capture", str(tmp_path))
    assert (code, output) == (1, "")
    assert errors.startswith(f"pinwm: {tmp_path / 'capture.yaml'}: no such file")
    (tmp_path / "file").write_text("")
    code, _, errors = pinwm("report", twin, "-o", str(tmp_path / "file/a.html"))
    assert (code, errors.count("\n")) == (1, 1)
