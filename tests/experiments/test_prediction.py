# SPDX-License-Identifier: MIT
import numpy as np
import pytest
from matplotlib.figure import Figure

import pinwm_drake as pw

PUSH = pw.capture_path("t_block") / "episodes" / "0001"


@pytest.fixture(scope="module")
def twin():
    return pw.load_twin("t_block")


@pytest.fixture(scope="module")
def prediction(twin):
    return pw.predict(twin, PUSH)


def test_a_twin_in_memory_predicts_as_its_folder(prediction):
    again = pw.predict("t_block", PUSH)
    assert np.array_equal(again.poses.p_WO, prediction.poses.p_WO)
    assert np.array_equal(again.spread.x, prediction.spread.x)


def test_errors_are_against_the_recorded_poses(prediction):
    recorded, found = prediction.episode.object_poses, prediction.poses
    assert np.array_equal(recorded.t, found.t)
    distance = np.linalg.norm(recorded.p_WO[:, :2] - found.p_WO[:, :2], axis=1)
    np.testing.assert_allclose(prediction.errors.position, distance, atol=1e-12)


def test_another_friction_is_another_motion_without_a_spread(twin, prediction):
    other = pw.predict(twin.with_theta(friction_floor=0.2), PUSH)
    assert other.spread is None
    assert other.errors.position[-1] > 3 * prediction.errors.position[-1]


def test_the_filmstrip_has_camera_twin_and_difference(prediction):
    strip = prediction.filmstrip(frames=3, size=60)
    assert strip.dtype == np.uint8
    assert strip.shape[0] % 3 == 0
    assert strip.shape[1] % 3 == 0
    assert max(strip.shape[:2]) <= 180
    camera, twin, difference = np.split(strip.astype(int), 3)
    assert np.abs(camera - twin).mean() < 10
    assert difference.mean() > camera.mean()  # it is mostly white


def test_the_figure_and_the_page_show_the_motion(prediction):
    assert isinstance(prediction.figure(), Figure)
    page = prediction.meshcat(height=200)
    assert page.height == 200
    assert "Drake MeshCat" in page.page
