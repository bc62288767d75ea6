# SPDX-License-Identifier: MIT
import json

import pytest

from tests.capture.pushed_cube import write_pushed_cube


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")
    return write_pushed_cube(tmp_path / "capture")


def test_a_good_capture_passes(pinwm, folder):
    code, out, err = pinwm("capture", "check", str(folder))
    assert (code, err) == (0, "")
    assert out.strip() == f"{folder}: 0 errors, 0 warnings, 8 static views, 1 episode, 10 images"


def test_errors_are_listed_with_file_row_and_value(pinwm, folder):
    table = folder / "episodes/0000/trajectory.csv"
    table.write_text(table.read_text().replace(",0.16,", ",nan,", 1))
    (folder / "static/images/003.png").unlink()
    code, out, err = pinwm("capture", "check", str(folder))
    assert (code, err) == (1, "")
    rows = " ".join(line.replace("│", " ") for line in out.splitlines()).split("error")
    assert "static/images/003.png" in rows[1]
    assert "no such file" in rows[1]
    assert "episodes/0000/trajectory.csv, row 2" in rows[2]
    assert "vx = nan" in rows[2]
    assert "a finite number from -1000 to 1000" in rows[2]
    assert "2 errors, 0 warnings" in out.splitlines()[-1]


def test_warnings_alone_pass(pinwm, folder):
    path = folder / "capture.yaml"
    path.write_text(path.read_text().replace("gravity: 9.81", "gravity: 1.6"))
    code, out, _ = pinwm("capture", "check", str(folder))
    assert code == 0
    assert "warning" in out
    assert "0 errors, 1 warning," in out.splitlines()[-1]


def test_problems_with_one_cause_share_a_row(pinwm, folder):
    table = folder / "episodes/0000/trajectory.csv"
    table.write_text(table.read_text().replace(",0.16,", ",x,"))
    code, out, _ = pinwm("capture", "check", str(folder))
    assert code == 1
    assert out.count("vx = x") == 1
    assert "9 more like this; --all shows them" in out
    assert "10 errors" in out
    assert pinwm("capture", "check", "--all", str(folder))[1].count("vx = x") == 10


def test_a_wrong_focal_length_has_a_row_for_static_views_and_one_for_an_episode(pinwm, folder):
    for path in (folder / "static/transforms.json", folder / "episodes/0000/camera.json"):
        document = json.loads(path.read_text())
        for name in ("fl_x", "fl_y"):
            document[name] *= 0.85
        path.write_text(json.dumps(document))
    _, out, _ = pinwm("capture", "check", str(folder))
    assert "7 more like this, in 8 files" in out
    assert out.count("mask against") == 2


def test_names_with_markup_are_shown_as_they_are(pinwm, folder):
    table = folder / "episodes/0000/frames.csv"
    table.write_text(table.read_text().replace("rgb/00003.png", "rgb/[bold]3[/red].png"))
    code, out, _ = pinwm("capture", "check", str(folder))
    assert code == 1
    assert "rgb/[bold]3[/red].png" in out


def test_something_else_is_no_capture(pinwm, folder):
    code, _, err = pinwm("capture", "check", str(folder / "nothing"))
    assert code == 1
    assert "no such folder" in err
    code, _, err = pinwm("capture", "check", str(folder / "capture.yaml"))
    assert code == 1
    assert "no such folder" in err
    code, out, _ = pinwm("capture", "check", str(folder / "static"))
    assert code == 1
    assert "capture.yaml" in out


def test_nothing_heavy_is_loaded_for_help():
    import subprocess
    import sys

    script = (
        "import sys, pinwm_drake.cli.capture as c\n"
        "heavy = {'torch', 'numpy', 'pydrake', 'cv2', 'scipy', 'trimesh'} & set(sys.modules)\n"
        "assert not heavy, heavy"
    )
    subprocess.run([sys.executable, "-c", script], check=True)
