# SPDX-License-Identifier: MIT
from pathlib import Path

import numpy as np
import pytest
import torch
import yaml

from pinwm_drake.capture.episodes import read_episode
from pinwm_drake.capture.scene import load_capture
from pinwm_drake.geometry.meshes import load_mesh, mass_properties
from pinwm_drake.spatial.rotations import quaternion_to_matrix
from pinwm_drake.systems.runs.realism import camera
from pinwm_drake.systems.runs.realism.stand_in import StandIn
from pinwm_drake.systems.scenario.load import load_setup
from tests.capture.cube import read_static_views
from tests.capture.pushed_cube import read_frames

SMALL = ["--size", "48", "--episodes", "2", "--static-views", "2", "--frames", "8", "--rate", "40"]
SMALL += ["--supersampling", "1", "--distance", "0.02"]


def files(folder: Path) -> dict[str, bytes]:
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    # Not through the command line: its fixture is one of functions.
    from pinwm_drake.cli.capture import simulate
    from pinwm_drake.systems.runs.capture_options import SimulateCaptureRequest, SimulateOptions

    out = tmp_path_factory.mktemp("simulate") / "capture"
    options = SimulateOptions(object_name="cube", friction=0.2, pusher_friction=0.4, mass=0.5, size=48, episodes=2,
                              static_views=2, frames=8, rate=40.0, supersampling=1, distance=0.02, seed=3)  # fmt: skip
    simulate(SimulateCaptureRequest(out, options))
    return out


def test_help_shows_an_example(pinwm):
    code, output, _ = pinwm("capture", "simulate", "--help")
    assert code == 0
    assert "Example: pinwm capture simulate" in output


def test_the_capture_can_be_read(made):
    capture = load_capture(made)
    assert (capture.object.name, capture.object.mass) == ("cube", 0.5)
    assert (capture.floor_height, capture.gravity) == (0.0, 9.81)
    assert capture.episode_names == ["0000", "0001"]
    assert capture.pusher.shape is not None
    assert len(read_static_views(made)) == 2
    load_mesh(capture.pusher.mesh_path)
    starts = []
    for name in capture.episode_names:
        episode = read_episode(capture, name)
        images, masks = read_frames(episode)
        assert images.shape == (8, 48, 48, 3)
        # In view from the first picture to the last.
        assert masks.any(dim=1).any(dim=1).all()
        assert not masks[:, [0, -1]].any()
        assert not masks[:, :, [0, -1]].any()
        assert np.diff(episode.trajectory.t).max() <= 1 / 120
        np.testing.assert_allclose(episode.object_poses.p_WO[0], capture.object.X_WO.p, atol=1e-9)
        np.testing.assert_allclose(np.abs(episode.object_poses.q_WO[0] @ capture.object.X_WO.q.numpy()), 1)
        assert np.linalg.norm(episode.object_poses.p_WO[-1] - episode.object_poses.p_WO[0]) > 0.005
        starts.append(episode.trajectory.p_WP[0])
    assert np.linalg.norm(starts[0] - starts[1]) > 0.01


def test_the_truth_is_written_for_scoring(made):
    truth = yaml.safe_load((made / "ground_truth.yaml").read_text())
    inertia = mass_properties(load_mesh(made / "meshes/object.obj"), mass=0.5).inertia
    assert truth == pytest.approx(
        {"mass": 0.5, "friction_floor": 0.2, "friction_pusher": 0.4, "restitution": 0.0}
        | {f"inertia_{a}{b}": inertia["xyz".index(a), "xyz".index(b)] for a, b in ("xx", "yy", "zz", "xy", "xz", "yz")}
    )


def test_the_same_seed_makes_the_same_files(pinwm, made, tmp_path):
    code, output, errors = pinwm(
        "capture", "simulate", str(tmp_path / "again"), "--object", "cube", "--friction", "0.2",
        "--pusher-friction", "0.4", "--mass", "0.5", "--seed", "3", *SMALL,
    )  # fmt: skip
    assert (code, errors) == (0, "")
    assert f"wrote {tmp_path / 'again'}" in output
    assert files(tmp_path / "again") == files(made)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["again", "again.simulate.config.yaml"]


def test_a_mug_can_lie(pinwm, tmp_path):
    options = ["--object", "mug", "--lying", "--pusher", "cylinder", "--friction", "0.3", *SMALL, "--episodes", "0"]
    assert pinwm("capture", "simulate", str(tmp_path / "mug"), *options)[0] == 0
    X_WO = load_capture(tmp_path / "mug").object.X_WO
    # Between the inner and the outer radius of a 64-gon.
    assert 0.04 * np.cos(np.pi / 64) - 1e-4 < float(X_WO.p[2]) < 0.04
    # Its axis is level.
    assert abs(float(quaternion_to_matrix(X_WO.q)[2, 2])) < 1e-3


# The mug may roll about its axis of symmetry: the tilt of that axis is what has to come back.
@pytest.mark.parametrize(
    ("body", "axes"), [(["cube"], (0, 1, 2)), pytest.param(["mug", "--lying"], (2,), marks=pytest.mark.nightly)]
)
def test_a_poke_rocks_an_object_and_leaves_it_on_its_face(pinwm, tmp_path, body, axes):
    code, _, errors = pinwm(
        "capture", "simulate", str(tmp_path / "poked"), "--task", "flip", "--object", *body, "--friction", "0.2",
        "--pusher-friction", "0.9", "--seed", "1", "--episodes", "1", "--size", "48", "--static-views", "1",
        "--frames", "60", "--rate", "120", "--supersampling", "1",
    )  # fmt: skip
    assert (code, errors) == (0, "")
    capture = load_capture(tmp_path / "poked")
    episode = read_episode(capture, "0000")
    speed = np.linalg.norm(episode.trajectory.v_WP, axis=1).max()
    assert 0.3 <= speed <= 0.5
    assert episode.trajectory.v_WP[:, 2].max() > 0.05
    heights, ups = (
        episode.object_poses.p_WO[:, 2],
        quaternion_to_matrix(torch.from_numpy(episode.object_poses.q_WO))[:, 2],
    )
    assert heights.max() - heights[0] > 0.001
    np.testing.assert_allclose(ups[-1][list(axes)], ups[0][list(axes)], atol=0.27)


def test_a_folder_with_files_is_left_alone(pinwm, tmp_path):
    (tmp_path / "mine").write_text("kept")
    code, _, errors = pinwm("capture", "simulate", str(tmp_path), *SMALL)
    assert code == 1
    assert "allowed: a new or empty folder" in errors
    assert [path.name for path in tmp_path.iterdir()] == ["mine"]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--task", "juggle"], "--task: got juggle; allowed: push, flip"),
        (["--object", "teapot"], "--object: got teapot"),
        (["--friction", "-1"], "--friction: got -1"),
        (["--pusher", "hand"], "--pusher: got 'hand'"),
        (["--lying"], "--lying: got True; allowed: with a mug only"),
        (["--speed", "nan"], "--speed: got nan"),
        (["--rise", "0.9", "0.8"], "--rise: got 0.9 to 0.8"),
        (["--distance", "0.5", "--mass", "inf"], "--mass: got inf"),
        (["--size", "0"], "--size: got 0"),
        (["--pusher-friction", "nan"], "--pusher-friction: got nan; allowed: 0 to 2"),
        (["--restitution", "1"], "--restitution: got 1.0; allowed: 0 to 0.9"),
        (["--mass", "0"], "--mass: got 0.0; allowed: 0.001 to 100 kg"),
        (["--pusher-radius", "0.1"], "--pusher-radius: got 0.1; allowed: 0.003 to 0.05 m"),
    ],
)
def test_options_out_of_range_are_named(pinwm, tmp_path, options, message):
    code, _, errors = pinwm("capture", "simulate", str(tmp_path / "new"), *options)
    assert code == 1
    assert message in errors
    assert not list(tmp_path.iterdir())


@pytest.mark.nightly
def test_a_realistic_capture_is_a_bit_off(pinwm, made, tmp_path):
    out = tmp_path / "real"
    code, output, errors = pinwm("capture", "simulate", str(out), "--object", "cube", "--friction", "0.2",
        "--mass", "0.5", "--seed", "3", "--realistic", *SMALL)  # fmt: skip
    assert (code, errors) == (0, "")
    assert f"wrote {out}" in output
    capture = load_capture(out)
    truth = yaml.safe_load((out / "ground_truth.yaml").read_text())
    plain = mass_properties(load_mesh(out / "meshes/object.obj"), mass=0.5).inertia
    # A lump, off the middle; the mesh that is written is that of the even object.
    assert abs(truth["inertia_xx"] / plain[0, 0] - 1.0) > 0.01
    assert (out / "meshes/object.obj").read_bytes() == (made / "meshes/object.obj").read_bytes()
    for name in capture.episode_names:
        episode = read_episode(capture, name)
        poses = episode.object_poses
        shift = poses.p_WO[0] - capture.object.X_WO.p.numpy()
        assert 1e-4 < np.linalg.norm(shift[:2]) < 0.03
        # It stands on feet, and the log is not by the camera's clock, but goes on beyond the video.
        assert 0.0300 < poses.p_WO[0, 2] < 0.0302
        assert episode.trajectory.t[0] < episode.t[0]
        assert episode.trajectory.t[-1] > episode.t[-1]
        _, masks = read_frames(episode)
        assert masks.any(dim=1).any(dim=1).all()
    assert (out / "static/images/00000.png").read_bytes() != (made / "static/images/00000.png").read_bytes()


@pytest.mark.nightly
def test_a_capture_of_the_stand_in_is_of_its_object_in_its_light(pinwm, tmp_path, monkeypatch):
    lit, light = [], camera.light
    monkeypatch.setattr(camera, "light", lambda recorder, params: lit.append(params) or light(recorder, params))
    filmed, film = [], camera.LabCamera.film
    monkeypatch.setattr(camera.LabCamera, "film", lambda self, *args: filmed.append(args[-1]) or film(self, *args))
    few = ["--size", "48", "--episodes", "1", "--static-views", "2", "--frames", "2", "--rate", "24"]
    few += ["--supersampling", "1", "--distance", "0.02", "--object", "t_block"]
    for seed in (1, 2):
        code, _, errors = pinwm(
            "capture", "simulate", str(tmp_path / f"{seed}"), "--seed", f"{seed}", "--stand-in", *few
        )
        assert (code, errors) == (0, "")
    truths = [yaml.safe_load((tmp_path / f"{seed}/ground_truth.yaml").read_text()) for seed in (1, 2)]
    (tmp_path / "models").mkdir()
    true = StandIn().true_scene(load_setup("push_t"), tmp_path / "models")
    theta = {name: one.value for name, one in true.twin.theta.items()}
    for truth in truths:
        # The same lump whatever the capture's seed is: it is that of the station.
        assert truth["inertia_xx"] == pytest.approx(theta["inertia_xx"], rel=1e-6)
        assert truth["inertia_zz"] == pytest.approx(theta["inertia_zz"], rel=1e-6)
    episode = read_episode(load_capture(tmp_path / "1"), "0000")
    # It is filmed by the camera that policies see by, which is not where it is believed to be.
    believed = load_setup("push_t").X_WC
    np.testing.assert_allclose(episode.X_WC.p, believed.translation(), atol=1e-9)
    R_WC = quaternion_to_matrix(episode.X_WC.q).numpy()
    np.testing.assert_allclose(R_WC, believed.rotation().matrix(), atol=1e-9)
    assert [X_WC.IsExactlyEqualTo(StandIn().camera(believed)) for X_WC in filmed] == [True, True]
    assert not believed.IsNearlyEqualTo(filmed[0], 1e-3)
    poses = episode.object_poses
    assert 0.0250 < poses.p_WO[0, 2] < 0.0252  # on feet
    lamp = StandIn().lamp().lights[0].position
    assert [list(params.lights[0].position) for params in lit] == 2 * [list(lamp)]
