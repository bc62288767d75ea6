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
    fx, fy, cx, cy = view.camera.intrinsics.tolist()
    row, column = np.indices(seen.shape[:2])
    ahead = np.stack([(column + 0.5 - cx) / fx, (row + 0.5 - cy) / fy, np.ones(row.shape)], -1).reshape(-1, 3)
    expected = station.lens.project(apply(inverse(from_pose(station.X_WC)), apply(X_WV, ahead)))
    within = ((expected > 1) & (expected < [1279, 719])).all(1)
    assert within.mean() > 0.9
    # OpenCV's remap has steps of 1/32 px.
    assert np.abs(seen.reshape(-1, 2) - expected)[within].max() < 0.05


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
