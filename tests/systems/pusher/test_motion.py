# SPDX-License-Identifier: MIT
import numpy as np
import pytest

from pinwm_drake.errors import ParameterError
from pinwm_drake.systems.pusher.motion import ScriptedPush, StraightPush
from tests.systems.pushers import PERIOD, Track
from tests.systems.scenes import AWAY

PUSH = StraightPush(np.array([0.1, 0.2, 0.3]), np.array([0.6, 0.8, 0.0]), 0.1, 0.05, 2.0, 0.25)


def test_speed_is_a_trapezoid():
    # Up within 0.1 / 2 = 0.05 s, 0.05 / 0.1 + 0.05 = 0.55 s from start to stop.
    assert PUSH.end_time == pytest.approx(0.8)
    assert PUSH.travel(0.2) == (0.0, 0.0)
    assert PUSH.travel(0.275)[1] == pytest.approx(0.05)
    assert PUSH.travel(0.5)[1] == pytest.approx(0.1)
    assert PUSH.travel(0.775)[1] == pytest.approx(0.05)
    assert PUSH.travel(0.9) == (0.05, 0.0)


def test_way_is_the_integral_of_the_speed():
    times = np.linspace(0.2, 0.9, 70001)
    ways, speeds = np.array([PUSH.travel(t) for t in times]).T
    trapezia = np.concatenate([[0], np.cumsum(0.5 * (speeds[1:] + speeds[:-1]) * np.diff(times))])
    # 1e-5 s of the trapezoidal rule around the four kinks.
    np.testing.assert_allclose(ways, trapezia, atol=1e-9)


def test_a_push_survives_its_vector():
    again = StraightPush.from_vector(PUSH.to_vector())
    np.testing.assert_array_equal(again.to_vector(), PUSH.to_vector())


def test_a_push_too_short_for_its_speed_is_refused():
    with pytest.raises(ValueError, match="distance of speed"):
        StraightPush(np.zeros(3), np.array([1.0, 0.0, 0.0]), 1.0, 0.1, 2.0)


def test_a_scripted_pusher_is_where_the_push_has_it_at_the_end_of_every_period():
    track = Track(ScriptedPush(PERIOD), PUSH.p_WP)
    np.testing.assert_array_equal(track.position(10 * PERIOD)[0], PUSH.p_WP)  # no push is set yet
    track = Track(ScriptedPush(PERIOD), PUSH.p_WP)
    track.system.SetPush(track.mine(), PUSH)
    for k in range(1, 220):
        way, _ = PUSH.travel(k * PERIOD)
        np.testing.assert_allclose(track.position(k * PERIOD)[0], PUSH.p_WP + way * PUSH.direction_W, atol=1e-12)
    assert way == PUSH.distance


def test_a_scripted_velocity_is_constant_within_a_period_and_follows_its_parameter():
    system = ScriptedPush(0.01)
    context = system.CreateDefaultContext()
    system.SetPush(context, PUSH)
    for t in (0.27, 0.27 * (1 - 1e-15), 0.2799):  # speeding up at 2 m/s², 0.02 s to 0.03 s after the start
        context.SetTime(t)
        np.testing.assert_allclose(system.get_output_port().Eval(context), 0.05 * PUSH.direction_W, rtol=1e-9)
    # Another push at the same time: the port's cache has to notice.
    system.SetPush(context, AWAY)
    np.testing.assert_array_equal(system.get_output_port().Eval(context), 0)
    copy = context.Clone()
    system.SetPush(context, PUSH)
    np.testing.assert_array_equal(system.get_output_port().Eval(copy), 0)
    with pytest.raises(ParameterError, match="period: got 0"):
        ScriptedPush(0.0)
