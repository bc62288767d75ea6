# SPDX-License-Identifier: MIT
import numpy as np
import pytest
from pydrake.geometry import Meshcat

from pinwm_drake.systems.engines.engine import FLOOR_PAIR, PUSHER_PAIR, ContactForces
from pinwm_drake.systems.view.meshcat import make_meshcat
from tests.systems.shown import SmallSetup, matrix, small_setup, station, value


@pytest.fixture(scope="module")
def meshcat():
    return make_meshcat()


@pytest.fixture(scope="module")
def setup():
    return small_setup()


def arrow(meshcat: Meshcat, name: str) -> tuple[np.ndarray, np.ndarray] | None:
    """Where an arrow starts, and its tip, (3,) m each, world; None while it is hidden."""
    path = f"/station/forces/{name}"
    if not value(meshcat, path, "visible"):
        return None
    X_WA = matrix(meshcat, path)
    shaft = value(meshcat, f"{path}/shaft", "scale")[2]
    # A cylinder of 1 m around its middle: it begins at the point of contact.
    assert value(meshcat, f"{path}/shaft", "position") == pytest.approx([0, 0, 0.5 * shaft])
    # The head begins where the shaft ends; the cone's tip is its origin, and it opens backwards.
    assert value(meshcat, f"{path}/head", "position") == pytest.approx([0, 0, shaft])
    cone = matrix(meshcat, f"{path}/head/cone")
    np.testing.assert_allclose(cone[:3, 2], [0, 0, -1], atol=1e-12)
    tip = shaft + value(meshcat, f"{path}/head", "scale")[2] * cone[2, 3]
    return X_WA[:3, 3], X_WA[:3, 3] + tip * X_WA[:3, 2]


def published(meshcat: Meshcat, setup: SmallSetup, forces: ContactForces) -> None:
    diagram = station(meshcat, setup, forces=forces)
    diagram.ForcedPublish(diagram.CreateDefaultContext())


def test_forces_are_arrows_of_their_length_and_direction(meshcat, setup):
    p_WC = np.array([[0.1, 0.0, 0.0], [0.0, 0.2, 0.03], [0.0, 0.0, 9.0], [0.4, 0.1, 0.0], [0.0, 0.3, 0.0]])
    f_W = np.array([[0.0, 0.0, 4.0], [-3.0, 0.0, 0.0], [5.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1e-6]])
    pairs = (FLOOR_PAIR, PUSHER_PAIR, PUSHER_PAIR, FLOOR_PAIR, FLOOR_PAIR)
    published(meshcat, setup, ContactForces(np.array([0, 0, 1, 0, 0]), pairs, p_WC, f_W))
    expected = {
        # 10 mm for each newton.
        "floor/0": (p_WC[0], p_WC[0] + [0, 0, 0.04]),
        "floor/1": (p_WC[3], p_WC[3] + [0.01, 0, 0]),
        # Weights 4 : 1, and the weight of a micronewton.
        "floor/sum": ([0.16, 0.02, 0], [0.16 + 0.01, 0.02, 0.04]),
        "pusher/sum": (p_WC[1], p_WC[1] + [-0.03, 0, 0]),
        # Too small, the same as the sum, and none; that of another world is not there at all.
        "floor/2": None,
        "pusher/0": None,
        "pusher/23": None,
    }
    for name, ends in expected.items():
        found = arrow(meshcat, name)
        if ends is None:
            assert found is None, name
        else:
            np.testing.assert_allclose(found, ends, atol=1e-6, err_msg=name)
    published(meshcat, setup, ContactForces.none())
    assert all(arrow(meshcat, name) is None for name in expected)


def test_of_more_forces_than_arrows_the_largest_are_shown(meshcat, setup):
    f_W = np.zeros((40, 3))
    f_W[:, 2] = np.arange(1, 41)
    published(meshcat, setup, ContactForces(np.zeros(40, int), (FLOOR_PAIR,) * 40, np.zeros((40, 3)), f_W))
    tips = [arrow(meshcat, f"floor/{k}")[1][2] for k in range(24)]
    np.testing.assert_allclose(tips, 0.01 * np.arange(40, 16, -1))
    # An arrow is cut off at half a metre; the sum would be 8.2 m long.
    assert arrow(meshcat, "floor/sum")[1][2] == pytest.approx(0.5)
