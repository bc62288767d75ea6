# SPDX-License-Identifier: MIT
import logging

import numpy as np
import pytest
import trimesh

from pinwm_drake.systems.view.motion import Moving, motion_page
from tests.systems.view.test_meshcat import messages

BOX = trimesh.creation.box((0.1, 0.1, 0.1))


def moving(number: int, **changes) -> Moving:
    """A box that moves by 0.2 m along x in a second from t = 2 s on, in a number of rows."""
    t, p_WB = np.linspace(2.0, 3.0, number), np.zeros((number, 3))
    p_WB[:, 0] = 0.2 * (t - 2.0)
    return Moving(BOX, t, p_WB, np.tile([1.0, 0.0, 0.0, 0.0], (number, 1)), (1.0, 0.0, 0.0), **changes)


@pytest.fixture(scope="module")
def commands():
    page = motion_page({"twin": moving(1001), "recorded": moving(5, opacity=0.5)}, 0.0)
    return messages(page)


def test_the_page_holds_the_bodies_and_their_way(commands):
    (animation,) = [one for one in commands if one["type"] == "set_animation"]
    ways = {one["path"].rsplit("/", 1)[-1]: one["clip"]["tracks"] for one in animation["animations"]}
    assert set(ways) == {"twin", "recorded"}
    for name, tracks in ways.items():
        (track,) = [one for one in tracks if one["name"] == ".position"]
        times, places = zip(*[(key["time"], key["value"]) for key in track["keys"]], strict=True)
        # The page plays from the first row on, thirty frames a second at most.
        assert (times[0], times[-1]) == (0, 30), name
        assert len(times) <= 31, name
        assert places[0][0] == pytest.approx(0.0)
        assert places[-1][0] == pytest.approx(0.2)


def test_the_floor_lies_under_what_moves(commands):
    (floor,) = [one for one in commands if one["type"] == "set_transform" and one["path"].endswith("floor")]
    matrix = np.array(floor["matrix"]).reshape(4, 4).T
    assert matrix[2, 3] < 0.0
    assert matrix[0, 3] == pytest.approx(0.1)


def test_it_is_silent(caplog):
    with caplog.at_level(logging.INFO):
        motion_page({"twin": moving(2)}, 0.0)
    assert not caplog.records
