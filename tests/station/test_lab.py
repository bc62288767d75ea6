# SPDX-License-Identifier: MIT
import numpy as np
import pytest

from pinwm_drake.errors import InputError
from pinwm_drake.spatial.rigid import rigid
from pinwm_drake.station.lab import load_lab, photos_in, read_poses

LAB = "schema_version: 1\nruler: 0.1\nrobot: {length: mm, angle: deg}\nworkspace: {low: [0, 0, 0], high: [1, 1, 1]}\n"
CSV = "file,x,y,z,rx,ry,rz\nrobot/a.jpg,100,200,300,90,0,0\nrobot/b.jpg,150,200,300,0,0,180\n"


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "robot").mkdir()
    for name in ("a", "b"):
        (tmp_path / f"robot/{name}.jpg").touch()
    (tmp_path / "lab.yaml").write_text(LAB)
    (tmp_path / "robot.csv").write_text(CSV)
    return tmp_path


def test_poses_are_in_metres_and_radians(folder):
    lab = load_lab(folder)
    assert [photo.name for photo in lab.photos] == ["robot/a.jpg", "robot/b.jpg"]
    np.testing.assert_allclose(lab.photos[0].X_BE, rigid([0.1, 0.2, 0.3], [np.pi / 2, 0, 0]), atol=1e-12)


@pytest.mark.parametrize(
    ("header", "values"),
    [
        ("qw,qx,qy,qz", "0.5,0.5,0.5,0.5"),
        ("qx,qy,qz,qw", "0.5,0.5,0.5,0.5"),
        ("qz,qw,qx,qy", "-0.5,-0.5,-0.5,-0.5"),
        ("rx,ry,rz", "69.2820323,69.2820323,69.2820323"),
        ("roll,pitch,yaw", "90,0,90"),
    ],
)
def test_rotations_in_all_forms_are_the_same(folder, header, values):
    path = folder / "robot.csv"
    path.write_text(f"file,x,y,z,{header}\na,0,0,0,{values}\nb,100,0,0,{values}\n")
    X = read_poses(path, "mm", "deg")["a"]
    # A third of a turn about (1, 1, 1) takes x to y, y to z and z to x.
    np.testing.assert_allclose(X[:3, :3], [[0, 0, 1], [1, 0, 0], [0, 1, 0]], atol=1e-7)


@pytest.mark.parametrize(
    ("file", "old", "new", "part"),
    [
        ("lab.yaml", "ruler: 0.1\n", "", "no ruler"),
        ("lab.yaml", "ruler: 0.1\n", "ruler: 0.5\n", "ruler = 0.5"),
        ("lab.yaml", "length: mm", "length: m", "are these mm? then robot.length: mm"),
        ("lab.yaml", ", angle: deg", "", "no robot.angle"),
        ("lab.yaml", "ruler", "lens: round\nruler", "lens = "),
        ("lab.yaml", "ruler", "board: {square: 0.01}\nruler", "board marker"),
        ("robot.csv", "file,x", "photo,x", "row 1"),
        ("robot.csv", "rx,ry,rz", "rx,ry,qz", "row 1"),
        ("robot.csv", "robot/b.jpg", "robot/a.jpg", "row 3: got file = robot/a.jpg; allowed: each photo once ("),
        ("robot.csv", "robot/b.jpg", "robot/c.jpg", "robot/b.jpg"),
        ("robot.csv", "100,200", "100,x", "row 2: got y = x"),
        ("robot.csv", "90,0,0", "90,0", "row 2: got 6 cells"),
        ("robot.csv", "150,200", "100,200", "then robot.length: m"),
        ("robot.csv", "90,0,0", "9e4,0,0", "see robot.angle"),
    ],
)
def test_wrong_labs_are_refused_by_file_and_row(folder, file, old, new, part):
    path = folder / file
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new))
    with pytest.raises(InputError) as caught:
        load_lab(folder)
    assert part in str(caught.value)


def test_rows_without_contents_are_left_out_and_counted(folder):
    path = folder / "robot.csv"
    path.write_text(CSV.replace("robot/b", "\n , ,,,,,\nrobot/b"))
    assert list(read_poses(path, "mm", "deg")) == ["robot/a.jpg", "robot/b.jpg"]
    path.write_text(path.read_text().replace("150", "x"))
    with pytest.raises(InputError, match="row 5: got x = x"):
        read_poses(path, "mm", "deg")


def test_a_wrong_quaternion_is_refused_by_its_row(folder):
    (folder / "robot.csv").write_text("file,x,y,z,qw,qx,qy,qz\na,0,0,0,1,0,0,0\nb,100,0,0,0.9,0,0,0\n")
    with pytest.raises(InputError, match=r"row 3: got qw, qx, qy, qz = .* of norm 0\.9"):
        read_poses(folder / "robot.csv", "mm", None)


def test_photos_whose_results_would_have_one_name_are_refused(folder):
    assert photos_in(folder / "nothing") == []
    (folder / "robot/A.png").touch()
    with pytest.raises(InputError, match=r"robot: got A\.png and a\.jpg; allowed: names that differ"):
        load_lab(folder)


def test_a_row_without_photo_and_a_folder_without_lab_are_refused(folder):
    (folder / "robot/b.jpg").unlink()
    with pytest.raises(InputError, match=r"robot/b\.jpg, which is not there"):
        load_lab(folder)
    with pytest.raises(InputError, match=r"lab\.yaml"):
        load_lab(folder / "robot")
