# SPDX-License-Identifier: MIT
import itertools
import math

import numpy as np
import pytest
from pydrake.common.eigen_geometry import AngleAxis
from pydrake.math import RigidTransform, RotationMatrix

from pinwm_drake.systems.mpc.approach import way_past
from pinwm_drake.systems.scenario.load import load_setup
from pinwm_drake.systems.scenario.start import StartDistribution


@pytest.mark.parametrize("scene", ["flip_mug", "flip_cube"])
def test_a_further_try_begins_beside_or_over_the_object_without_a_touch(scene):
    setup, generator = load_setup(scene), np.random.default_rng(0)
    starts, pusher = StartDistribution(setup), setup.scenario.pusher
    count = 0
    for _ in range(200):
        place, begun = starts.anywhere(generator)
        assert np.all((place.p_WP >= pusher.low) & (place.p_WP <= pusher.high))
        X_WO = place.X_WO
        points = X_WO.multiply(starts.vertices.T).T
        radius, height = starts.clear_of(X_WO)
        count += place.p_WP[2] >= height and np.hypot(*(place.p_WP - X_WO.translation())[:2]) < radius
        way = way_past(X_WO.translation(), place.p_WP, begun, (radius, height), 0.05)
        fine = np.concatenate([np.linspace(a, b, 20) for a, b in itertools.pairwise(way)])
        level = np.linalg.norm(fine[:, :2] - X_WO.translation()[:2], axis=1)
        reach = np.linalg.norm(points[:, :2] - X_WO.translation()[:2], axis=1).max()
        assert np.all((fine[:, 2] > points[:, 2].max() + 0.01) | (level > reach + 0.009))
    assert 50 < count < 110


@pytest.mark.parametrize("scene", ["flip_mug", "flip_cube"])
def test_a_further_try_begins_on_the_side_where_the_scene_has_the_pusher_however_the_object_lies(scene):
    setup, generator = load_setup(scene), np.random.default_rng(1)
    starts, start = StartDistribution(setup), setup.scenario.start
    slack = 0.5 * (np.ptp(start.pusher_gap) + 0.12 * np.ptp(start.pusher_angle)) + 1e-9
    for _ in range(20):
        place = starts.draw(generator)
        begun = starts.beside(place.X_WO)
        assert np.linalg.norm(begun - place.p_WP) <= slack
        away = (begun - place.X_WO.translation()) * [1.0, 1.0, 0.0]
        across = np.cross(away, [0.0, 0.0, 1.0])
        for axis, angle, sign in ((away, math.pi, 1.0), ([0.0, 0.0, 1.0], math.pi, -1.0), (across, 0.5 * math.pi, 0.0)):
            R = RotationMatrix(AngleAxis(angle, np.array(axis) / np.linalg.norm(axis)))
            there = starts.beside(RigidTransform(R @ place.X_WO.rotation(), place.X_WO.translation()))
            if sign:
                np.testing.assert_allclose((there - place.X_WO.translation())[:2], sign * away[:2], atol=1e-9)
            else:
                assert there is None
