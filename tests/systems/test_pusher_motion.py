import numpy as np
import pytest
from pinwm_drake.systems.pusher_motion import PusherMotion, StraightPush

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


def test_the_system_commands_the_push_of_its_context():
    system = PusherMotion()
    context = system.CreateDefaultContext()
    system.SetPush(context, PUSH)
    context.SetTime(0.5)
    state = system.get_output_port().Eval(context)
    way, speed = PUSH.travel(0.5)
    np.testing.assert_allclose(state, [*(PUSH.p_WP + way * PUSH.direction_W), *(speed * PUSH.direction_W)])
    # Another push at the same time: the port's cache has to notice.
    system.SetPush(context, AWAY)
    np.testing.assert_allclose(system.get_output_port().Eval(context), [0, 0, 50, 0, 0, 0])
    copy = context.Clone()
    np.testing.assert_array_equal(system.get_output_port().Eval(copy), system.get_output_port().Eval(context))


def test_a_push_survives_its_vector():
    again = StraightPush.from_vector(PUSH.to_vector())
    np.testing.assert_array_equal(again.to_vector(), PUSH.to_vector())


def test_a_push_too_short_for_its_speed_is_refused():
    with pytest.raises(ValueError, match="distance of speed"):
        StraightPush(np.zeros(3), np.array([1.0, 0.0, 0.0]), 1.0, 0.1, 2.0)
