# SPDX-License-Identifier: MIT
import pytest
import yaml

from pinwm_drake.capture.scene import PusherShape, load_capture
from tests.capture.cube import HEIGHT, read_static_views, write_mesh, write_views
from tests.capture.pushed_cube import write_pushed_cube
from tests.capture.test_colmap import model_of, write_binary
from tests.capture.test_pinwm import GOAL, START, write_like_theirs


@pytest.fixture
def scan(tmp_path):
    return write_views(tmp_path / "scan", size=48, count=8)


@pytest.fixture
def mesh(tmp_path):
    return str(write_mesh(tmp_path / "cube.obj"))


def test_nerfstudio(pinwm, scan, mesh, tmp_path):
    out = tmp_path / "out"
    options = ["--mesh", mesh, "--name", "my cube", "--pose", f"0 0 {HEIGHT} 1 0 0 0", "--mass", "0.3"]
    options += ["--floor", "-0.001", "--gravity", "9.81", "--pusher-shape", "capsule 0.01 0.1"]
    code, text, err = pinwm("capture", "import", "nerfstudio", str(scan), str(out), *options)
    assert (code, err) == (0, "")
    assert f"wrote {out}: 8 static views" in text
    assert f"pinwm capture check {out}" in text
    capture = load_capture(out)
    assert (capture.object.name, capture.object.mass) == ("my cube", 0.3)
    assert capture.object.X_WO.p.tolist() == [0, 0, HEIGHT]
    assert (capture.floor_height, capture.gravity) == (-0.001, 9.81)
    assert capture.pusher.shape == PusherShape("capsule", 0.01, 0.1)
    code, text, _ = pinwm("capture", "check", str(out))
    assert code == 0
    assert "no episode" in text


def test_colmap(pinwm, scan, mesh, tmp_path):
    write_binary(scan / "sparse/0", *model_of(scan))
    (tmp_path / "world.yaml").write_text("[[2, 0, 0, 0.5], [0, 2, 0, 0], [0, 0, 2, 0], [0, 0, 0, 1]]")
    out = tmp_path / "out"
    options = ["--mesh", mesh, "--pose", f"0.5,0,{2 * HEIGHT},1,0,0,0"]
    transform = ["--transform", str(tmp_path / "world.yaml")]
    code, text, err = pinwm("capture", "import", "colmap", str(scan), str(out), *options, *transform)
    assert (code, err) == (0, "")
    assert "8 static views" in text
    # Twice as far away, so that the cube of the mesh is half as large as the one in the images.
    assert read_static_views(out)[0].X_CO.p[2].item() == pytest.approx(2 * 0.3 * 1.1662, rel=1e-3)
    _, text, _ = pinwm("capture", "check", "--all", str(out))
    assert "area x 4." in " ".join(text.replace("│", " ").split())


def test_pinwm(pinwm, tmp_path):
    cube = write_pushed_cube(tmp_path / "cube")
    theirs = write_like_theirs(cube, tmp_path / "theirs", START, GOAL)
    out = tmp_path / "out"
    options = ["--mesh", str(cube / "meshes/object.obj"), "--pusher-mesh", str(cube / "meshes/object.obj")]
    code, text, err = pinwm(
        "capture", "import", "pinwm", str(theirs), str(out), *options, "--pusher-height", f"{HEIGHT}"
    )
    assert code == 0
    assert "cameras [0, 1], of which 0 is imported" in err
    assert "episode 0000 from dynamic_train0.json" in text
    document = yaml.safe_load((out / "capture.yaml").read_text())
    assert document["pusher"] == {"mesh": "meshes/pusher.obj", "shape": None}
    assert (out / "episodes/0000/object_poses.csv").is_file()


@pytest.mark.parametrize(
    ("options", "part"),
    [
        (["--pose", "0 0 1"], '--pose: got "0 0 1"; allowed: seven numbers'),
        (["--pose", "0 0 0 2 0 0 0"], "a unit quaternion"),
        (["--pose", "0 0 nan 1 0 0 0"], "--pose"),
        (["--pusher-shape", "cube 1"], '--pusher-shape: got "cube 1"'),
        (["--pusher-shape", "capsule 0.1"], '"capsule R LENGTH"'),
        (["--pusher-shape", "sphere 70"], "0.0001 to 5 m"),
        (["--scale", "0"], "--scale: got 0"),
        (["--transform", "nothing.yaml"], "nothing.yaml"),
    ],
)
def test_wrong_options_are_refused(pinwm, scan, mesh, tmp_path, options, part):
    code, _, err = pinwm("capture", "import", "nerfstudio", str(scan), str(tmp_path / "out"), "--mesh", mesh, *options)
    assert code == 1
    assert part in " ".join(err.split())
    assert not (tmp_path / "out").exists()


def test_a_pusher_is_needed_for_pushes(pinwm, tmp_path):
    code, _, err = pinwm("capture", "import", "pinwm", str(tmp_path), str(tmp_path / "out"), "--mesh", "m.obj")
    assert code == 1
    assert "--pusher-mesh" in err


@pytest.mark.parametrize("options", [["--mass", "nan"], ["--mass", "0"], ["--gravity", "-9.8"], ["--floor", "inf"]])
def test_options_out_of_range_are_refused(pinwm, scan, mesh, tmp_path, options):
    code, _, err = pinwm("capture", "import", "nerfstudio", str(scan), str(tmp_path / "out"), "--mesh", mesh, *options)
    assert code == 1
    assert f"pinwm: {options[0]}: got {float(options[1])}; allowed: " in err
