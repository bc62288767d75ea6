# SPDX-License-Identifier: MIT
import base64
import os
import re
import signal
import subprocess
import sys
import urllib.request
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from pinwm_drake.capture.episode_tables import read_frame_table, read_object_poses, read_trajectory
from pinwm_drake.capture.episodes import read_fixed_camera
from pinwm_drake.twin.write import write_twin
from tests.streams import without_note
from tests.twin.samples import cube_twin, estimates

ROOT = Path(__file__).parents[2]
SCENARIO = """
units: {length: m, mass: kg, time: s, angle: rad}
name: small push
object: cube
theta: {mass: 0.5, friction_floor: 0.4, friction_pusher: 0.1}
pusher: {max_speed: 0.3, low: [-0.3, -0.3, 0.01], high: [0.3, 0.3, 0.2]}
camera: {width: 48, height: 40}
start: {x: [-0.02, 0.02], y: [-0.02, 0.02], yaw: [-3.0, 3.0], pusher_height: 0.03}
"""


@pytest.fixture(scope="module")
def scenario(tmp_path_factory) -> str:
    path = tmp_path_factory.mktemp("scenario") / "small.scenario.yaml"
    path.write_text(SCENARIO)
    return str(path)


def table(output: str) -> dict[str, str]:
    """The rows of the table that was printed."""
    return {row[0].strip(): row[1].strip() for row in re.findall(r"│([^│]+)│([^│]+)│", output)}


def moved(output: str) -> list[float]:
    """mm, as printed: the length, and x, y, z."""
    return [float(number) for number in re.findall(r"[-+]?\d+\.\d", table(output)["object moved"])]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--engine", "bullet"], "--engine: got 'bullet'; allowed: twin, hydroelastic, point"),
        (["--seed", "-1"], "--seed: got -1; allowed: 0 to 4294967295"),
        (["--duration", "nan"], "--duration: got nan; allowed: 0.01 to 600 s"),
        (["--video", "a.avi"], "--video: got a.avi; allowed: a name that ends in .mp4"),
        (["--record", "a.mp4"], "--record: got a.mp4; allowed: a name that ends in .html or .htm"),
        (["--push", "round"], "--push: got 'round'; allowed: straight, or the path of a trajectory.csv"),
        (["--push", "no/trajectory.csv"], "no/trajectory.csv: no such file or directory; allowed: a file that"),
        (["--twin", "no"], "no: no such folder; allowed: a twin, as `pinwm identify` writes it, or one of t_block"),
    ],
)
def test_bad_input_is_one_line_and_exits_with_1(pinwm, scenario, tmp_path, arguments, message):
    out = tmp_path / "out"
    code, output, errors = pinwm("simulate", scenario, "-o", str(out), *arguments)
    assert (code, output) == (1, "")
    assert errors.startswith(f"pinwm: {message}")
    assert errors.count("\n") == 1
    assert not out.exists()


def test_what_is_to_be_simulated_has_to_be_there(pinwm, scenario, tmp_path):
    ships = "flip_cube, flip_mug, flip_mug_handle, push_cube, push_cube_slippery, push_large_t, push_mug, push_t"
    code, _, errors = pinwm("simulate", "push_tea")
    wanted = f"allowed: a file, a twin's folder, or one of {ships} (did you mean push_t?)"
    assert (code, errors) == (1, f"pinwm: push_tea: no such scenario; {wanted}\n")
    code, _, errors = pinwm("simulate")
    assert (code, errors) == (1, f"pinwm: SCENARIO: got none, and no --twin; allowed: a file, {ships}\n")
    code, _, errors = pinwm("simulate", str(tmp_path), "--twin", str(tmp_path))
    assert code == 1
    assert "allowed: one of the two" in errors
    (tmp_path / "file").write_text("")
    code, _, errors = pinwm("simulate", scenario, "-o", str(tmp_path))
    assert code == 1
    assert "allowed: a new or empty folder" in errors


def test_help_shows_an_example(pinwm):
    code, output, _ = pinwm("simulate", "--help")
    assert code == 0
    assert "Example: pinwm simulate push_t" in output


@pytest.fixture(scope="module")
def episode(pinwm, scenario, tmp_path_factory) -> Path:
    """What one run writes; its output is beside it."""
    folder = tmp_path_factory.mktemp("simulate")
    options = ["--seed", "5", "-o", folder / "new/ep", "--video", folder / "film.mp4", "--record", folder / "page.html"]
    code, output, errors = pinwm("simulate", scenario, *map(str, options))
    assert (code, errors) == (0, "")
    (folder / "output.txt").write_text(output)
    return folder


def test_the_episode_can_be_read(episode):
    folder = episode / "new/ep"
    assert sorted(path.name for path in folder.iterdir()) == [
        "camera.json",
        "frames.csv",
        "object_poses.csv",
        "rgb",
        "trajectory.csv",
    ]
    log, poses = read_trajectory(folder), read_object_poses(folder)
    names, t = read_frame_table(folder, log.t)
    assert np.allclose(t, np.arange(len(t)) / 30, atol=1e-9)
    assert np.allclose(log.t, np.arange(len(log.t)) / 240, atol=1e-9)
    assert (poses.t == log.t).all()
    # The commanded velocities lead from row to row.
    assert np.abs(log.p_WP[:-1] + np.diff(log.t)[:, None] * log.v_WP[:-1] - log.p_WP[1:]).max() < 1e-12
    assert (log.p_WP[:, 2] == 0.03).all()
    assert np.linalg.norm(log.p_WP[-1] - log.p_WP[0]) == pytest.approx(0.112, abs=1e-6)
    assert np.abs(poses.p_WO[-24:] - poses.p_WO[-1]).max() < 1e-4  # at rest
    camera, _ = read_fixed_camera(folder)
    assert (camera.width, camera.height) == (48, 40)
    pictures = [np.asarray(Image.open(folder / name)) for name in names]
    assert all(picture.shape == (40, 48, 4) and (picture[..., 3] == 255).any() for picture in pictures)
    assert (pictures[0] != pictures[-1]).any()


def test_what_is_said_is_what_happened(episode):
    output, poses = (episode / "output.txt").read_text(), read_object_poses(episode / "new/ep")
    said = table(output)
    assert said["engine"] == "twin"
    assert said["at rest"] == "yes"
    assert said["solver retries"].isdigit()
    way = 1e3 * (poses.p_WO[-1] - poses.p_WO[0])
    assert moved(output) == pytest.approx([np.linalg.norm(way), *way], abs=0.0501)
    turned = 2 * np.degrees(np.arccos(min(abs(poses.q_WO[0] @ poses.q_WO[-1]), 1)))
    assert float(said["object turned"].rstrip("°")) == pytest.approx(turned, abs=0.0501)
    assert f"{poses.t[-1]:.3f} s" in said["simulated"]
    lines = output.splitlines()[-3:]
    assert lines == [f"wrote {episode / name}" for name in ("new/ep", "film.mp4", "page.html")]


def test_the_film_shows_scene_and_rgb(episode):
    reader = cv2.VideoCapture(str(episode / "film.mp4"))
    _, t = read_frame_table(episode / "new/ep", None)
    assert reader.get(cv2.CAP_PROP_FRAME_COUNT) == len(t)
    assert reader.get(cv2.CAP_PROP_FPS) == pytest.approx(30)
    frame = reader.read()[1]
    assert frame.shape == (480, 2 * 576, 3)
    # White where the rgb port shows nothing; the floor of the scene is not.
    assert frame[20:60, 600:640].min() > 240
    assert frame[20:60, 20:60].max() < 240


def test_the_page_holds_the_recording(episode):
    page = (episode / "page.html").read_text()
    messages = b"".join(map(base64.b64decode, re.findall("base64,([A-Za-z0-9+/=]+)", page)))
    assert b"set_animation" in messages
    assert b"/station/scene" in messages


def test_an_episode_can_be_replayed(pinwm, scenario, episode):
    code, output, errors = pinwm("simulate", scenario, "--push", str(episode / "new/ep/trajectory.csv"))
    assert (code, errors) == (0, "")
    # It starts where that one did, whatever the seed. On the log the pusher is where it was to rounding.
    assert moved(output) == pytest.approx(moved((episode / "output.txt").read_text()), abs=0.2)


@pytest.mark.parametrize("engine", ["hydroelastic", "point"])
def test_drakes_engines(pinwm, scenario, episode, engine):
    code, output, errors = pinwm("simulate", scenario, "--engine", engine, "--seed", "5")
    assert (code, errors) == (0, "")
    assert table(output)["engine"] == engine
    assert "solver retries" not in table(output)
    # The start and the push are those of the twin with this seed.
    assert moved(output)[0] == pytest.approx(moved((episode / "output.txt").read_text())[0], abs=4)


def test_the_seed_decides(pinwm, scenario, tmp_path):
    starts = []
    for name, seed in (("a", "7"), ("b", "7"), ("c", "8")):
        options = ["--seed", seed, "--duration", "0.1", "-o", str(tmp_path / name)]
        code, output, _ = pinwm("simulate", scenario, *options)
        assert code == 0
        assert "0.100 s" in table(output)["simulated"]
        starts.append((tmp_path / name / "object_poses.csv").read_bytes())
    assert starts[0] == starts[1] != starts[2]


def test_a_twin_without_a_scenario(pinwm, tmp_path):
    write_twin(tmp_path / "twin", cube_twin(tmp_path, floor_height=0.1, theta=estimates(restitution_pusher=0.0)))
    out = tmp_path / "ep"
    code, output, errors = pinwm("simulate", str(tmp_path / "twin"), "--seed", "1", "-o", str(out))
    assert (code, errors) == (0, "")
    assert moved(output)[0] > 80
    poses, log = read_object_poses(out), read_trajectory(out)
    assert poses.p_WO[0, 2] == pytest.approx(0.1 + 0.03, abs=1e-9)  # a cube of 60 mm on its floor
    assert log.p_WP[0, 2] == pytest.approx(0.1 + 0.034, abs=1e-9)  # a capsule of 60 mm, 4 mm above it
    again = pinwm("simulate", "--twin", str(tmp_path / "twin"), "--seed", "1")[1]
    assert table(again)["object moved"] == table(output)["object moved"]


def test_a_twin_in_the_place_of_the_object(pinwm, scenario, tmp_path):
    write_twin(tmp_path / "twin", cube_twin(tmp_path))
    code, output, errors = pinwm("simulate", scenario, "--twin", str(tmp_path / "twin"), "--duration", "0.05")
    assert (code, errors) == (0, "")
    assert "small push" in output


def test_no_room_to_push(pinwm, tmp_path):
    path = tmp_path / "box.scenario.yaml"
    path.write_text(SCENARIO.replace("[0.3, 0.3, 0.2]", "[0.03, 0.03, 0.2]").replace("[-0.3, -0.3", "[-0.03, -0.03"))
    code, _, errors = pinwm("simulate", str(path))
    assert code == 1
    assert errors.startswith(
        "pinwm: pusher.low, pusher.high: got [-0.03, -0.03, 0.01] and [0.03, 0.03, 0.2] m; allowed:"
    )


@pytest.mark.nightly
def test_meshcat_until_ctrl_c(scenario):
    # Where the tests run in the background of a script, Ctrl-C is ignored, and a child inherits that.
    listen = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)"
    command = [sys.executable, "-u", "-c", f"{listen}; from pinwm_drake.cli import main; main()"]
    arguments = ["simulate", scenario, "--meshcat", "--duration", "0.3"]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    process = subprocess.Popen(
        [*command, *arguments], cwd=ROOT, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    try:
        assert process.stdout.readline().startswith("the object acts as a box of ")
        first = process.stdout.readline()
        url = re.fullmatch(r"Meshcat is at (http://localhost:\d+)\n", first)
        assert url, first + process.stderr.read() if process.poll() else first
        with urllib.request.urlopen(url[1], timeout=30) as page:
            assert b"meshcat" in page.read().lower()
        for line in process.stdout:
            if "solver retries" in line:
                break
        process.send_signal(signal.SIGINT)
        rest, errors = process.communicate(timeout=120)
    finally:
        process.kill()
    assert (process.returncode, without_note(errors)) == (0, "")
    assert rest.endswith("ended\n")
