# SPDX-License-Identifier: MIT
import numpy as np
import pytest

from pinwm_drake.errors import InputError
from pinwm_drake.tasks.waypoints import WAYPOINTS_FILE, Waypoints


def some(**changes):
    arrays = {
        "object_state": np.zeros((4, 13)),
        "p_WP": np.zeros((4, 3)),
        "action": np.zeros((4, 3)),
        "past": np.zeros((4, 2, 3)),
    }
    return Waypoints(**arrays | changes)


def test_waypoints_come_back(tmp_path):
    assert len(Waypoints.read(tmp_path)) == 0
    for waypoints in (Waypoints(), some(), some(past=np.zeros((4, 0, 3))), some(past=np.zeros((0, 0, 3)))):
        waypoints.write(tmp_path, {})
        assert Waypoints.read(tmp_path).digest() == waypoints.digest()


@pytest.mark.parametrize(
    ("name", "array", "words"),
    [
        ("object_state", np.full((4, 13), np.nan), "object_state with a number that is not finite"),
        ("object_state", np.zeros((3, 13)), r"object_state of float64 \(3, 13\)"),
        ("p_WP", np.zeros((4, 2)), r"p_WP of float64 \(4, 2\)"),
        ("action", np.zeros(4), r"action of float64 \(4,\)"),
        ("past", np.zeros((4, 2)), r"past of float64 \(4, 2\)"),
        ("past", np.zeros((4, 2, 3), int), r"past of int64 \(4, 2, 3\)"),
    ],
)
def test_other_arrays_are_refused(tmp_path, name, array, words):
    some(**{name: array}).write(tmp_path, {})
    with pytest.raises(InputError, match=f"{WAYPOINTS_FILE}: got {words}; allowed: "):
        Waypoints.read(tmp_path)
