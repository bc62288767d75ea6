# SPDX-License-Identifier: MIT
import dataclasses
import re
import warnings
from dataclasses import astuple

import cv2
import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from pinwm_drake.control.runner import Runner
from pinwm_drake.errors import InputError, ParameterError
from pinwm_drake.experiments.requests.train import TrainRequest
from pinwm_drake.experiments.training import worlds_of
from pinwm_drake.geometry.meshes import load_mesh
from pinwm_drake.learning.bundle import read_bundle
from pinwm_drake.learning.spec import PolicySpec
from pinwm_drake.spatial.poses import Pose
from pinwm_drake.station.document import StationDocument, write_station
from pinwm_drake.station.view import view_of
from pinwm_drake.systems.envs.env import TaskEnv
from pinwm_drake.systems.envs.policy_scene import home_scene, scene_record
from pinwm_drake.systems.scenario.at_station import at_station, latency_of
from pinwm_drake.systems.scenario.load import load_setup
from pinwm_drake.systems.scenario.start import StartDistribution
from tests.station.stations import plain_station

HEIGHT = 0.02  # m, of the table
WIDE = {"low": [0.25, -0.3, HEIGHT], "high": [0.85, 0.3, 0.3]}


def make(folder, file="station.yaml", **changes):
    contents = plain_station()
    contents["world"]["table"]["height"] = HEIGHT
    contents |= {"workspace": WIDE, "latency": {"camera": [0.03, 0.05], "robot": [0.0, 0.02]}} | changes
    return write_station(folder / file, StationDocument.model_validate(contents))


def test_policies_see_the_object_where_the_camera_of_the_station_does(tmp_path):
    # OpenCV projects the object into the distorted image, and frees that of distortion as `view_of` turns it.
    station = make(tmp_path)
    setup = at_station(load_setup("push_t"), station)
    env, vertices = TaskEnv(setup, "twin", observation="rgb", image_size=64), load_mesh(setup.twin.mesh_path).vertices
    about, X_WC = station.document.camera, matrix(station.X_WC)
    K, distortion = np.array(about.K) - [[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]], np.array(about.distortion)
    view = view_of(station)
    X_CW, R_VC = np.linalg.inv(X_WC), matrix(view.X_WV)[:3, :3].T @ X_WC[:3, :3]
    for seed in range(3):
        image = env.reset(seed=seed)[0]["image"]
        rows, columns = np.nonzero((image < 250).any(-1))
        p_W = vertices @ matrix(pose_of(env)).T[:3, :3] + matrix(pose_of(env))[:3, 3]
        uv = cv2.projectPoints(p_W, cv2.Rodrigues(X_CW[:3, :3])[0], X_CW[:3, 3], K, distortion)[0]
        rays = cv2.undistortPoints(uv, K, distortion)[:, 0]
        rays = np.column_stack([rays, np.ones(len(rays))]) @ R_VC.T
        seen = 32 + float(view.camera.intrinsics[0]) * rays[:, :2] / rays[:, 2:]
        assert np.abs([columns.min(), rows.min()] - seen.min(0)).max() < 1.5
        assert np.abs([columns.max() + 1, rows.max() + 1] - seen.max(0)).max() < 1.5


def pose_of(env):
    q, p = np.split(env.run.object_state[0, :7], [4])
    return Pose(torch.from_numpy(q.copy()), torch.from_numpy(p.copy()))


def matrix(pose):
    X = np.eye(4)
    X[:3, :3] = Rotation.from_quat(np.roll(pose.q.numpy(), -1)).as_matrix()
    X[:3, 3] = pose.p.numpy()
    return X


@pytest.mark.parametrize("scene", ["push_t", "flip_mug"])
def test_the_scene_is_moved_as_a_whole(tmp_path, scene):
    here = load_setup(scene)
    there = at_station(here, make(tmp_path))
    moved, object_state = np.array([0.55, 0.0, HEIGHT]), np.zeros((1, 13))
    object_state[0, 0], object_state[0, 4:7], p_WP = 1.0, [0.03, -0.02, 0.05], np.array([[-0.1, 0.04, 0.03]])
    shifted = object_state.copy()
    shifted[0, 4:7] += moved
    np.testing.assert_allclose(there.task.state(shifted, p_WP + moved), here.task.state(object_state, p_WP), atol=1e-6)
    measures = there.task.measure(shifted, p_WP + moved), here.task.measure(object_state, p_WP)
    for found, wanted in zip(*map(astuple, measures), strict=True):
        assert (found is None) == (wanted is None)
        if wanted is not None:
            np.testing.assert_allclose(found, wanted, atol=1e-9)
    place, wanted = (StartDistribution(setup).middle() for setup in (there, here))
    np.testing.assert_allclose(place.X_WO.translation(), wanted.X_WO.translation() + moved, atol=1e-9)
    np.testing.assert_allclose(place.p_WP, wanted.p_WP + moved, atol=1e-9)
    box = there.scenario.pusher
    assert np.allclose(box.low[:2], WIDE["low"][:2])
    assert np.allclose([box.high[0], box.low[2]], [WIDE["high"][0], here.scenario.pusher.low[2] + HEIGHT])


def test_starts_are_those_of_the_station_or_as_the_workspace_has_room(tmp_path):
    here, given = load_setup("push_t"), {"x": [0.5, 0.6], "y": [-0.02, 0.05], "yaw": [0.0, 0.3]}
    start = at_station(here, make(tmp_path, start=given)).scenario.start
    assert (start.x, start.y, start.yaw) == (given["x"], given["y"], given["yaw"])
    narrow = {"low": [0.35, -0.2, HEIGHT], "high": [0.75, 0.2, 0.3]}
    with pytest.warns(UserWarning, match=r"room for starts at x 0\.4\d+ to 0\.6"):
        setup = at_station(here, make(tmp_path, "narrow.yaml", workspace=narrow))
    distribution, generator = StartDistribution(setup), np.random.default_rng(0)
    for _ in range(50):
        p_WP = distribution.draw(generator).p_WP
        assert (p_WP[:2] >= narrow["low"][:2]).all()
        assert (p_WP[:2] <= narrow["high"][:2]).all()


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"view": None}, "no view; allowed: p_WT"),
        ({"view": {"p_WT": [0.55, 0, 0], "fov_y": 0.5, "size": [64, 48]}}, "view.size 64 x 48 px"),
        ({"view": {"p_WT": [0.55, 0, 0], "fov_y": 0.1, "size": [64, 64]}}, "does not show the whole object at x 0"),
        ({"workspace": {"low": [0.5, -0.3, HEIGHT], "high": [0.7, 0.3, 0.3]}}, "a workspace of 0.200 m along x"),
        ({"start": {"x": [0.3, 0.6], "y": [0, 0], "yaw": [0, 0]}}, "start.x 0.300 to 0.600 m; allowed: 0."),
    ],
)
def test_what_a_station_lacks_is_refused_by_its_key(tmp_path, changes, words):
    with pytest.raises(InputError, match=re.escape(words)):
        at_station(load_setup("push_t"), make(tmp_path, **changes))


def test_another_tool_than_the_pusher_is_told(tmp_path):
    same, other = ({"shape": {"kind": "sphere", "radius": radius}} for radius in (0.01, 0.006))
    with pytest.warns(UserWarning, match="the tool is a sphere of 6 mm; training keeps the pusher of push_t"):
        at_station(load_setup("push_t"), make(tmp_path, tool=other))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        at_station(load_setup("push_t"), make(tmp_path, "same.yaml", tool=same))


def test_a_twin_keeps_the_floor_that_it_was_identified_with_at_this_station_alone(tmp_path):
    station, setup = make(tmp_path), load_setup("push_t")
    about = {"capture": "c", "capture_sha256": "0" * 64, "episode": "push", "station": station.sha256}
    own = dataclasses.replace(setup, twin=dataclasses.replace(setup.twin, floor_height=0.0185, provenance=about))
    assert at_station(own, station).twin.floor_height == 0.0185
    assert at_station(own, make(tmp_path, "other.yaml", name="other")).twin.floor_height == HEIGHT


def test_a_training_is_for_its_station_and_other_ones_are_refused(tmp_path):
    station = make(tmp_path)
    request = TrainRequest("push_t", tmp_path / "out", worlds=2, goals="random", goal_reach=0.05, station=station.path)
    worlds = worlds_of(request)
    spec = PolicySpec.from_document(worlds.spec("rgb").to_document())
    assert (spec.station, spec.latency, spec.camera.width) == (station.sha256, (0.03, 0.07), 64)
    assert spec.task.goal == (0.55, 0.0, 0.0)
    assert latency_of(make(tmp_path, "quick.yaml", latency={}).document) == (0.0, 0.0)
    home = home_scene(spec, {"home": scene_record("push_t", None, station.path)}, tmp_path)
    assert home.station == station.sha256
    assert home.scenario.camera == worlds.setup.scenario.camera
    with pytest.raises(InputError, match=r"allowed: .*other"):
        home_scene(spec, {"home": scene_record("push_t", None, make(tmp_path, "other.yaml", name="other").path)}, "p")
    for name, value in (("image_size", 32), ("as_filmed", True)):
        with pytest.raises(ParameterError, match=f"--{name.replace('_', '-')}"):
            TrainRequest("push_t", tmp_path, station=station.path, **{name: value})
    bundle = read_bundle("push_t")
    Runner(bundle)
    placed = dataclasses.replace(bundle, spec=dataclasses.replace(bundle.spec, station=station.sha256))
    Runner(placed, station=tmp_path)  # the folder with station.yaml
    Runner(placed, live=False)
    for other in (tmp_path / "other.yaml", None):
        with pytest.raises(InputError, match=r"bundle: .* station"):
            Runner(placed, station=other)
