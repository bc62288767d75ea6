# SPDX-License-Identifier: MIT
import numpy as np
import pytest
import torch

from pinwm_drake.spatial.poses import Pose
from tests.capture.cube import SIDE
from tests.report.samples import log
from tests.twin.samples import MASS, cube_twin, estimates, pusher_force, weighing

START = Pose(
    torch.tensor([1.0, 0.0, 0.0, 0.0], dtype=torch.float64),
    torch.tensor([0.0, 0.0, SIDE / 2], dtype=torch.float64),
)
FRICTION, GRAVITY = 0.4, 9.81
T = np.array([0.0, 0.5])


@pytest.fixture
def twin(tmp_path):
    values = {"restitution_floor": 0.0, "restitution_pusher": 0.0, "friction_floor": FRICTION}
    return cube_twin(tmp_path, theta=estimates(**values))


def test_a_steady_push_through_the_middle_costs_the_floors_friction(twin):
    edges, force_W = pusher_force(twin, START, log(6), T)
    assert edges.shape == (121,)
    assert (edges[0], edges[-1]) == pytest.approx((0.0, 0.5))
    assert force_W.shape == (120, 3)
    # The pusher goes along x, and the object pushes back.
    steady = force_W[edges[:-1] > 0.2]
    np.testing.assert_allclose(steady[:, 0], -FRICTION * MASS * GRAVITY, rtol=1e-3)
    np.testing.assert_allclose(steady[:, 1], 0.0, atol=1e-6)
    # The gap of 5 mm takes 50 ms, and what is given first is the speed of the push.
    assert not force_W[edges[:-1] < 0.045].any()
    early = force_W[edges[:-1] < 0.1].sum(0)[0] / 240
    assert early == pytest.approx(-MASS * (0.1 + 0.05 * FRICTION * GRAVITY), rel=0.1)


def test_forces_grow_with_the_mass(twin):
    _, light_W = pusher_force(twin, START, log(6), T)
    _, heavy_W = pusher_force(weighing(twin, 3.0), START, log(6), T)
    # The compliance of contacts is counted for the mass, so that the motion is the same.
    np.testing.assert_allclose(heavy_W.sum(0), 3.0 * light_W.sum(0), rtol=1e-4, atol=1e-4)
