# SPDX-License-Identifier: MIT
import math

import numpy as np
import pytest

from pinwm_drake.cousins.domain import CousinDomains
from pinwm_drake.systems.envs.training_worlds import TrainingWorlds, training_options
from pinwm_drake.systems.mpc.approach import approaches, around
from pinwm_drake.systems.scenario.start import StartDistribution


@pytest.mark.parametrize("turn", [0.0, 0.4, 2.0, math.pi, -3.0])
def test_a_way_around_an_axis_keeps_clear_of_it(turn):
    middle, begin = np.array([0.3, -0.1, 0.05]), np.array([0.4, -0.1, 0.25])
    end = middle + [0.09 * math.cos(turn), 0.09 * math.sin(turn), 0.01]
    points = around(middle, begin, end, 0.1)
    np.testing.assert_allclose(points[[0, -1]], [begin, end], atol=1e-12)
    assert np.linalg.norm(np.diff(points, axis=0), axis=1).max() <= 0.1 + 1e-12
    fine = np.concatenate([np.linspace(a, b, 50) for a, b in zip(points, points[1:], strict=False)])
    assert np.linalg.norm(fine[:, :2] - middle[:2], axis=1).min() > 0.09 - 1e-3
    assert len(points) < 10


@pytest.mark.parametrize("latency", [(0.0, 0.0), (0.0, 0.12)])
def test_pushers_go_around_an_object_to_where_episodes_begin(latency):
    options = training_options(latency=latency, history=2 if latency[1] else 0)
    worlds = TrainingWorlds("flip_cube", options, num_worlds=32, domains=CousinDomains(0.0))
    env = worlds.task_worlds("state").worlds
    env.reset([*range(32)])
    ways = approaches(env, StartDistribution(env.setup), np.random.default_rng(0))
    assert len(ways) > 40  # of 32 ways, some of which lead out of the pusher's box
    assert np.abs(ways.object_state[:, 7:]).max() < 0.05  # nothing is touched
    away = ways.p_WP - ways.object_state[:, 4:7]
    angles = np.arctan2(away[:, 1], away[:, 0])
    assert np.histogram(angles, 4, (-math.pi, math.pi))[0].min() > 3
    # After its last action a pusher is where the scene has it, in front of the object.
    start = env.setup.scenario.start
    after = ways.p_WP + env.run.max_translation * ways.action
    lowest = np.abs(after[:, 2] - start.pusher_height) < 0.01
    assert lowest.sum() > (0 if latency[1] else 10)
    assert ways.past.shape == (len(ways), env.actions_before, 3)
    if latency[1]:
        assert (np.abs(ways.past).max(axis=(1, 2)) > 0.0).any()
