# SPDX-License-Identifier: MIT
"""What errors of changes of velocity make of later poses, against closed forms."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from pinwm_drake.capture.episodes import PusherTrajectory
from pinwm_drake.capture.scene import PusherGeometry, PusherShape
from pinwm_drake.identification.discrepancy import prior_root
from pinwm_drake.identification.forward import Forward
from pinwm_drake.identification.unknowns import Coordinates
from pinwm_drake.models import object_model
from pinwm_drake.scene import make_scene
from pinwm_drake.spatial.poses import Pose
from pinwm_drake.twin.kicks import OF_HITS, PER_WALK, Kicks
from tests.identification.test_discrepancy import RADIUS, WALK, straight

LEVEL = torch.tensor([1.0, 0.0, 0.0, 0.0], dtype=torch.float64)
MU, G = 0.3, 9.81


def thrown(height, velocity, seconds=0.5):
    """Forward of a cube, 60 mm, that starts so high over its rest with a velocity (6,)."""
    path = object_model("cube").mesh_path
    scene = make_scene(path, PusherGeometry(None, PusherShape("sphere", 0.01)), q_WO=LEVEL, gravity=G)
    times = np.linspace(0.0, seconds, 11)
    far, still = np.tile([1.0, 1.0, 1.0], (2, 1)), np.tile([1.0, 0.0, 0.0, 0.0], (2, 1))
    trajectory = PusherTrajectory(np.array([0.0, seconds]), far, still, None, None)
    V = torch.tensor(velocity, dtype=torch.float64)
    episode = SimpleNamespace(times=times, trajectory=trajectory, start_velocity=V)
    start = Pose(LEVEL, torch.tensor([0.0, 0.0, 0.03 + height], dtype=torch.float64))
    coordinates = Coordinates(("friction_floor",), {"friction_floor": MU})
    values = coordinates.values(torch.zeros(1, 1, dtype=torch.float64))
    return Forward(scene, episode, start, 1.0, 1), values, times


def test_flight_has_no_errors():
    forward, values, _ = thrown(2.0, (0.0, 0.0, 0.0, 0.4, 0.0, 0.0))
    kicks = forward.kicks(values)
    assert kicks.slides.shape[0] == 66
    assert float(kicks.slides.abs().max()) < 1e-8
    assert kicks.hits.shape == (66, 0)


def test_what_slides_stops_elsewhere_by_its_speed_over_the_braking():
    v = 0.9
    forward, values, times = thrown(0.0, (0.0, 0.0, 0.0, v, 0.0, 0.0))
    kicks = forward.kicks(values)
    assert kicks.hits.shape == (66, 0)
    carried = kicks.slides.reshape(11, 6, -1, 6)
    last = carried[-1, 3, :, 3].numpy()
    # Parts are nearly equally long, in whole steps, from the start until it rests.
    ends = np.linspace(0.0, v / (MU * G), len(last) + 1)[1:]
    speeds = v - MU * G * ends
    change = MU * G * ends[0]
    # An error of the change in a part is carried on by the speed that is left.
    expected = -change * speeds / (MU * G)
    assert last[:-1] == pytest.approx(expected[:-1], rel=0.2, abs=2e-4)
    # Before the end of a part its error has no effect.
    for part, end in enumerate(ends):
        assert not carried[times < end - 0.01, :, part].any()


def test_a_hit_throws_aside_by_a_share_of_the_speed_that_it_takes():
    height, slide = 0.1, 0.8
    forward, values, times = thrown(height, (0.0, 0.0, 0.0, slide, 0.0, 0.0))
    hits = forward.kicks(values).hits.reshape(11, 6, -1, 6)
    assert hits.shape[2] == 1
    landing = math.sqrt(2.0 * height / G)
    # It lands flat: the floor takes all of the fall, and its friction MU times that of the speed along the floor.
    fall = G * landing
    change, left = fall * math.sqrt(1.0 + MU**2), slide - MU * fall
    before, last = times < landing, hits[-1, 3:, 0, 3]
    assert not hits[before].any()
    # An error along the motion is carried on until it rests.
    assert float(last[0]) == pytest.approx(change * left / (MU * G), rel=0.1)
    assert float(last[1]) == pytest.approx(0.0, abs=1e-4)


def test_errors_add_a_covariance_of_which_that_of_slides_grows_with_the_drift():
    X_WO, times = straight(5)
    generator = torch.Generator().manual_seed(0)
    slides, hits = (torch.randn(30, k, generator=generator, dtype=torch.float64) * 1e-3 for k in (4, 3))
    for walk in (WALK, 2.0 * WALK):
        plain, more = (prior_root(X_WO, times, RADIUS, walk, 1.0, some) for some in (None, Kicks(slides, hits)))
        expected = (PER_WALK * walk) ** 2 * slides @ slides.T + OF_HITS**2 * hits @ hits.T
        torch.testing.assert_close(more @ more.T - plain @ plain.T, expected)
