# SPDX-License-Identifier: MIT
"""Meshcat's page of a controlled station."""

import dataclasses
import re

import numpy as np
import pytest
import umsgpack

from pinwm_drake.geometry.meshes import load_mesh
from pinwm_drake.learning.safety import default_limits
from pinwm_drake.report.notice import draw_notice
from pinwm_drake.systems.control import page
from pinwm_drake.systems.control.loop import ControlLoop
from pinwm_drake.systems.control.page import whole_view
from pinwm_drake.systems.scenario.start import Place
from pinwm_drake.systems.view.meshcat import make_meshcat, recorded
from tests.systems.control.test_controller import PLACE
from tests.systems.policies import Follower, small_setup, spec_of
from tests.systems.view.test_meshcat import messages, packed

CAMERA = "/Cameras/default/rotated/<object>"


@pytest.fixture(scope="module")
def meshcat():
    return make_meshcat()


@pytest.fixture
def told(monkeypatch):
    """Texts that the page was given, one list for each change."""
    found = []

    def draw(lines, **options):
        found.append([text for text, _ in lines])
        return draw_notice(lines, **options)

    monkeypatch.setattr(page, "draw_notice", draw)
    return found


def loop_of(meshcat, **options):
    setup = small_setup(24)
    policy = Follower(spec_of(setup))
    return ControlLoop(policy, default_limits(policy.spec), setup, "twin", meshcat=meshcat, **options)


def test_the_page_has_goal_workspace_words_and_picture(meshcat, told):
    loop = loop_of(meshcat)
    loop.begin(PLACE)
    for name in (
        "/station/goal",
        "/station/workspace",
        *(f"{CAMERA}/{name}/0" for name in ("caption", "words", "picture")),
    ):
        assert meshcat._GetPackedObject(name), name
    assert ["what the policy sees"] in told
    # The outline lies at the goal, the origin of the world, a millimetre above the floor; the T-block is 100 mm wide.
    lines = umsgpack.unpackb(meshcat._GetPackedObject("/station/goal"), raw=False)["object"]
    points = np.frombuffer(lines["geometries"][0]["data"]["attributes"]["position"]["array"].data, "<f4").reshape(-1, 3)
    mesh = load_mesh(small_setup(24).twin.mesh_path)
    np.testing.assert_allclose(points[:, :2].min(axis=0), mesh.bounds[0, :2], atol=1e-6)
    np.testing.assert_allclose(points[:, :2].max(axis=0), mesh.bounds[1, :2], atol=1e-6)
    np.testing.assert_allclose(points[:, 2], 0.001, atol=1e-6)


def test_words_tell_state_reason_and_distance(meshcat, told):
    loop = loop_of(meshcat, armed=True)
    loop.begin(PLACE)
    loop.listen()
    for _ in loop.advance(0.3):
        pass
    first = [lines[0] for lines in told]
    assert first[1] == "disarmed: the pusher stays where it is"
    assert first[-1] == "running: the policy moves the pusher"
    assert "action 3: the object is 36 mm and 23° from the goal" in told[-1]
    assert told[-1][-1].startswith("success is rest within 20 mm")
    loop.controller.Fail(loop.simulator.get_mutable_context(), "the camera is unplugged")
    loop.stop()
    assert told[-1][:2] == ["stopped by a fault", "the camera is unplugged"]
    at_goal = Place(type(PLACE.X_WO)([0.0, 0.0, 0.025]), PLACE.p_WP)
    loop.begin(at_goal)
    assert told[-1][0] == "at the goal"


def test_a_recording_keeps_what_was_shown_and_when(meshcat, tmp_path):
    loop = loop_of(meshcat, armed=True, recording=True)
    path = tmp_path / "run.html"
    with recorded(meshcat, path):
        loop.begin(PLACE)
        loop.listen()
        for _ in loop.advance(1.0):
            pass
        loop.stop()
    html = path.read_text()
    (animation,) = (message for message in messages(html) if message["type"] == "set_animation")
    shown = {
        entry["path"]: [(key["time"], key["value"]) for key in entry["clip"]["tracks"][0]["keys"]]
        for entry in animation["animations"]
        if entry["path"].startswith(f"{CAMERA}/words/")
    }
    assert len(shown) > 2
    # One at a time, and one at every time.
    for frame in range(31):
        seen = [name for name, keys in shown.items() if max(key for key in keys if key[0] <= max(frame, keys[0][0]))[1]]
        assert len(seen) == 1, frame
    assert meshcat.HasPath(f"{CAMERA}/picture/0")
    # It needs no server: all assets that its commands name are in the file, and nothing comes from elsewhere.
    assets = set(re.findall(r'casAssets\["(cas-v1/\w+)"\] = "data:', html))
    named = {text.decode() for message in packed(html) for text in re.findall(rb"cas-v1/\w+", message)}
    assert len(named) > 4
    assert named <= assets
    assert not re.search(r'<(script|link|img)[^>]+(src|href)="(?!data:)', html)


def test_a_live_page_keeps_the_last_words_only(meshcat):
    loop = loop_of(meshcat, armed=True)
    loop.begin(PLACE)
    loop.listen()
    for _ in loop.advance(0.5):
        pass
    assert meshcat.HasPath(f"{CAMERA}/words/0")
    assert not meshcat.HasPath(f"{CAMERA}/words/1")


def test_a_task_without_one_goal_has_no_outline(meshcat):
    setup = small_setup(24)
    loop_of(meshcat)
    assert meshcat.HasPath("/station/goal")
    anywhere = dataclasses.replace(spec_of(setup).task)
    object.__setattr__(anywhere, "goal_pose", lambda height: None)
    page._draw_goal(meshcat, anywhere, setup)
    assert not meshcat.HasPath("/station/goal")


def test_the_whole_scene_is_in_view():
    generator = np.random.default_rng(0)
    X_WC = small_setup().X_WC
    for size in (0.1, 0.7, 3.0):
        points = generator.uniform(-size, size, (40, 3)) * [1, 1, 0.2]
        eye, target = whole_view(points, X_WC)
        forward = (target - eye) / np.linalg.norm(target - eye)
        right = np.cross(forward, [0, 0, 1])
        right /= np.linalg.norm(right)
        depth, half = (points - eye) @ forward, np.tan(np.radians(37.5))
        x, y = (points - eye) @ right / depth / half, (points - eye) @ np.cross(right, forward) / depth / half
        assert depth.min() > 0
        assert np.abs(x).max() < 0.9501
        assert -0.9201 < y.min() < y.max() < 0.6001
        # As large as it can be: it reaches two opposite edges.
        tall, wide = y.max() > 0.599 and y.min() < -0.919, x.max() > 0.949 and x.min() < -0.949
        assert tall or wide
