# SPDX-License-Identifier: MIT
import numpy as np
import pytest
import umsgpack
from pydrake.systems.analysis import Simulator

from pinwm_drake.systems.view.meshcat import make_meshcat
from pinwm_drake.systems.view.scene import frustum
from tests.systems.shown import CAMERA, X_WC, X_WO, matrix, small_setup, station, value


@pytest.fixture(scope="module")
def meshcat():
    return make_meshcat()


@pytest.fixture(scope="module")
def setup():
    return small_setup()


def test_everything_is_in_the_page_where_it_belongs(meshcat, setup):
    diagram = station(meshcat, setup)
    diagram.ForcedPublish(diagram.CreateDefaultContext())
    for path in ("floor", "camera", "surfels", "forces/floor/0/shaft", "forces/pusher/23/head/cone"):
        assert meshcat._GetPackedObject(f"/station/{path}")
    assert meshcat.HasPath("/station/scene/box/object")
    np.testing.assert_allclose(matrix(meshcat, "/station/surfels"), X_WO.GetAsMatrix4(), atol=1e-12)
    np.testing.assert_allclose(matrix(meshcat, "/station/scene/box/object"), X_WO.GetAsMatrix4(), atol=1e-12)
    np.testing.assert_allclose(matrix(meshcat, "/station/camera"), X_WC.GetAsMatrix4(), atol=1e-12)
    # The upper side of a plate of 1 mm is 0.1 mm below the floor.
    assert matrix(meshcat, "/station/floor")[2, 3] + 0.0005 == pytest.approx(0.02 - 0.0001)


@pytest.mark.parametrize(("name", "surfels"), [("twin", True), ("point", False)])
def test_the_twin_shows_surfels_and_the_others_their_meshes(meshcat, setup, name, surfels):
    diagram = station(meshcat, setup, name)
    # Also after what a simulation does when it begins.
    Simulator(diagram).Initialize()
    assert value(meshcat, "/station/surfels", "visible") is surfels
    assert value(meshcat, "/station/scene/box/object", "visible") is not surfels


def test_the_frustum_passes_through_the_images_corners():
    start, end = frustum(CAMERA, 0.2)
    assert start.shape == end.shape == (3, 8)
    assert not start[:, :4].any()
    np.testing.assert_allclose(end[2, :4], 0.2)
    fx, fy, cx, cy = CAMERA.intrinsics.tolist()
    np.testing.assert_allclose(fx * end[0, :4] / 0.2 + cx, [0, 64, 64, 0], atol=1e-12)
    np.testing.assert_allclose(fy * end[1, :4] / 0.2 + cy, [0, 0, 48, 48], atol=1e-12)
    np.testing.assert_array_equal(end[:, 4:], np.roll(end[:, :4], -1, axis=1))


def test_what_the_camera_sees_is_drawn_down_to_the_floor(meshcat, setup):
    station(meshcat, setup)
    lines = umsgpack.unpackb(meshcat._GetPackedObject("/station/camera"), raw=False)["object"]
    points = np.frombuffer(lines["geometries"][0]["data"]["attributes"]["position"]["array"].data, "<f4").reshape(-1, 3)
    heights = X_WC.multiply(points.T.astype(float))[2]
    apex = np.abs(points).max(axis=1) < 1e-9
    assert apex.sum() == 4
    np.testing.assert_allclose(heights[~apex], setup.twin.floor_height + 0.001, atol=1e-6)


def test_two_engines_stand_side_by_side(meshcat, setup):
    for name, prefix in (("twin", "/a"), ("point", "/b")):
        diagram = station(meshcat, setup, name, prefix=prefix)
        diagram.ForcedPublish(diagram.CreateDefaultContext())
    for prefix, surfels in (("/a", True), ("/b", False)):
        for part in ("floor", "camera", "surfels", "forces/floor/sum", "scene/box/object"):
            assert meshcat.HasPath(f"{prefix}/{part}")
        assert value(meshcat, f"{prefix}/surfels", "visible") is surfels
