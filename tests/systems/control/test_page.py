# SPDX-License-Identifier: MIT
"""Meshcat's page of a controlled station."""

import dataclasses
import re

import numpy as np
import pytest

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


def test_words_tell_state_reason_and_distance(meshcat, told):
    loop = loop_of(meshcat, armed=True)
    loop.begin(PLACE)
    loop.listen()
    for _ in loop.advance(0.3):
        pass
    first = [lines[0] for lines in told]
    assert len(told) < 6, "numbers are not told every action"
    assert first[1] == "disarmed: the pusher stays where it is"
    assert first[-1] == "running: the policy moves the pusher"
    loop.simulator.get_system().ForcedPublish(loop.simulator.get_context())
    assert "action 3: the object is 36 mm and 23° from the goal" in told[-1]
    assert told[-1][-1].startswith("success is rest within 20 mm")
    assert told[-1][-2] == f"t_block in {loop.station.setup.scenario.name}, twin"
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


def test_the_goal_is_an_outline_with_the_floor_within_it(meshcat, monkeypatch):
    drawn = {}
    monkeypatch.setattr(page, "show_sheets", lambda meshcat, path, sheets: drawn.update({path: sheets}))
    setup = small_setup(24)
    task = dataclasses.replace(spec_of(setup).task, goal=(0.1, -0.05, np.pi))
    page._draw_goal(meshcat, task, setup)
    within, rim = drawn["/station/goal"]
    # The T-block turned by half a turn: 100 mm wide and 140 mm long; the line is 3 mm wide.
    (low, high), middle = load_mesh(setup.twin.mesh_path).bounds[:, :2], np.array([0.1, -0.05])
    np.testing.assert_allclose(within.vertices[:, :2].min(axis=0), middle - high, atol=1e-6)
    np.testing.assert_allclose(within.vertices[:, :2].max(axis=0), middle - low, atol=1e-6)
    np.testing.assert_allclose(np.ptp(rim.vertices[:, :2], axis=0), high - low + 0.003, atol=1e-6)
    floor = setup.twin.floor_height
    assert floor < within.vertices[0, 2] < rim.vertices[0, 2] < floor + 0.002
    # Its area is that of the outline's length times the width.
    a, b, c = (rim.vertices[rim.faces][:, k, :2] for k in range(3))
    area = 0.5 * np.abs((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]).sum()
    assert area == pytest.approx(0.003 * 2 * (0.1 + 0.14), rel=0.02)


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
