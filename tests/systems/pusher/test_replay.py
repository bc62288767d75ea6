# SPDX-License-Identifier: MIT
import numpy as np
import pytest
import torch

from pinwm_drake.capture.episodes import PusherTrajectory
from pinwm_drake.errors import ParameterError
from pinwm_drake.scene import pusher_motion
from pinwm_drake.systems.pusher.motion import TrajectoryReplay
from tests.systems.pushers import PERIOD, Track


def recorded(rows=12, seed=0):
    """A log with uneven times that are no multiples of the period."""
    generator = np.random.default_rng(seed)
    t = 0.05 + np.cumsum(generator.uniform(0.01, 0.04, rows))
    p_WP = np.cumsum(generator.normal(0, 0.01, (rows, 3)), axis=0)
    return PusherTrajectory(t, p_WP, np.tile([1.0, 0, 0, 0], (rows, 1)), np.zeros((rows, 3)), None)


def on_the_line(log, t):
    return np.array([np.interp(t, log.t, log.p_WP[:, axis]) for axis in range(3)])


@pytest.mark.parametrize("start", [0.0, 0.1234, -0.2])
def test_the_pusher_is_on_the_logs_line_at_the_end_of_every_period(start):
    log = recorded()
    replay = TrajectoryReplay(log, PERIOD, start)
    np.testing.assert_allclose(replay.start_position, on_the_line(log, start), atol=1e-15)
    track = Track(replay, replay.start_position)
    for k in range(1, 200):
        at = track.position(k * PERIOD)[0]
        np.testing.assert_allclose(at, on_the_line(log, start + k * PERIOD), atol=1e-12)
    np.testing.assert_allclose(at, log.p_WP[-1], atol=1e-12)


def test_velocities_are_those_of_identification():
    log = recorded()
    replay = TrajectoryReplay(log, PERIOD)
    context = replay.CreateDefaultContext()
    motion = pusher_motion(log, 0.0, 200, PERIOD)
    for k, expected in enumerate(motion.V_WP[:, 3:]):
        # Also where rounding has made a time a little too short.
        for t in (k * PERIOD, k * PERIOD * (1 - 1e-15), (k + 0.9) * PERIOD):
            context.SetTime(t)
            np.testing.assert_array_equal(replay.get_output_port().Eval(context), expected)
    assert torch.count_nonzero(motion.V_WP) > 0


def test_after_its_end_a_log_stands():
    log = recorded()
    replay = TrajectoryReplay(log, PERIOD, start=100.0)
    np.testing.assert_array_equal(replay.start_position, log.p_WP[-1])
    np.testing.assert_array_equal(replay.get_output_port().Eval(replay.CreateDefaultContext()), 0)


def test_a_period_that_is_none_is_refused():
    with pytest.raises(ParameterError, match="period: got -1; allowed: more than 0 s"):
        TrajectoryReplay(recorded(), -1.0)
