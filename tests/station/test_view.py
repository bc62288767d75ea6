# SPDX-License-Identifier: MIT
import numpy as np
import pytest

from pinwm_drake.errors import InputError, ParameterError
from pinwm_drake.spatial.rigid import apply, from_pose, inverse
from pinwm_drake.station.document import write_station
from pinwm_drake.station.view import look_at, view_around, view_of
from tests.station.stations import EYE, TARGET, station_document


def test_points_are_seen_where_a_pinhole_without_roll_sees_them(tmp_path):
    station = write_station(tmp_path / "station.yaml", station_document())
    view = view_of(station)
    X_WV = from_pose(view.X_WV)
    np.testing.assert_allclose(X_WV, look_at(EYE, TARGET), rtol=0, atol=1e-12)
    # An image of the lens's own columns and rows, px: the view shows where the lens sees the ray of each pixel.
    x, y = np.meshgrid(np.arange(1280) + 0.5, np.arange(720) + 0.5)
    seen = view.remap(np.stack([x, y], -1).astype(np.float32))
    p_W = np.random.default_rng(0).uniform([0.45, -0.1, 0.0], [0.65, 0.1, 0.1], (50, 3))
    p_V = apply(inverse(X_WV), p_W)
    fx, fy, cx, cy = view.camera.intrinsics.tolist()
    there = np.column_stack([fx * p_V[:, 0] / p_V[:, 2] + cx, fy * p_V[:, 1] / p_V[:, 2] + cy])
    expected = station.lens.project(apply(inverse(from_pose(station.X_WC)), p_W))
    pixels = np.floor(there).astype(int)
    # Within a pixel of the view, which is 22 px of the lens.
    assert np.abs(seen[pixels[:, 1], pixels[:, 0]] - expected).max() < 25.0


def test_a_view_shows_all_of_the_workspace():
    points = station_document().workspace.points()
    about = view_around(np.array(EYE), points, np.array(TARGET))
    p_V = apply(inverse(look_at(EYE, TARGET)), points)
    half = np.tan(0.5 * about.fov_y)
    assert (np.abs(p_V[:, :2] / p_V[:, 2:]) < half).all()
    assert np.abs(p_V[:, :2] / p_V[:, 2:]).max() > 0.9 * half


def test_what_has_no_view_is_refused(tmp_path):
    document = station_document()
    station = write_station(tmp_path / "station.yaml", document.model_copy(update={"view": None}))
    with pytest.raises(ParameterError, match="no view"):
        view_of(station)
    camera = document.camera.model_copy(update={"mount": "hand", "X_WC": None, "X_EC": document.camera.X_WC})
    station = write_station(tmp_path / "hand.yaml", document.model_copy(update={"camera": camera}))
    with pytest.raises(InputError, match="a camera in the hand"):
        view_of(station)
    with pytest.raises(ParameterError, match="aslant"):
        look_at([0.0, 0.0, 1.0], [0.0, 0.0, 0.0])
