# SPDX-License-Identifier: MIT
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pinwm_drake.control.velocity_limiter import VelocityLimiter
from pinwm_drake.errors import ParameterError
from pinwm_drake.learning.safety import SafetyLimits

LOW, HIGH = np.array([-0.3, -0.2, 0.0]), np.array([0.3, 0.2, 0.1])
SPEED = 0.2
ROUNDING = 2e-9  # a share of 1e-9 in each of two velocities

numbers = st.floats(-1e300, 1e300) | st.floats(-0.5, 0.5)
vectors = st.tuples(numbers, numbers, numbers).map(np.array)
shares = st.tuples(*[st.floats(0.0, 1.0)] * 3).map(np.array)
periods = st.sampled_from([0.005, 0.1])
accelerations = st.sampled_from([0.05, 0.5, 4.0, 100.0])


def limits(acceleration=4.0, speed=SPEED):
    return SafetyLimits(tuple(LOW), tuple(HIGH), speed, acceleration, 0.1)


@settings(max_examples=200, deadline=None)
@given(shares, st.lists(vectors, min_size=1, max_size=40), periods, accelerations)
def test_no_limit_is_exceeded_whatever_is_wanted(share, wanted, period, acceleration):
    limiter = VelocityLimiter(limits(acceleration), period)
    p, v = LOW + share * (HIGH - LOW), np.zeros(3)
    for goal in wanted:
        before, v = v, limiter.limit(goal, v, p)
        p = p + period * v
        assert np.linalg.norm(v) <= SPEED * (1 + ROUNDING)
        assert np.linalg.norm(v - before) <= acceleration * period * (1 + ROUNDING)
        # Sums of a few hundred numbers of the size of the box: 1e-16 each.
        assert (p >= LOW - 1e-13).all()
        assert (p <= HIGH + 1e-13).all()


@settings(max_examples=200, deadline=None)
@given(vectors, vectors, vectors, periods)
def test_from_anywhere_a_pusher_comes_no_farther_out_of_its_box(wanted, before, p, period):
    # The velocity before may be anything, as may be the place: something else has moved the pusher.
    p, before = np.clip(p, -2.0, 2.0), np.clip(before, -SPEED, SPEED) / np.sqrt(3)
    v = VelocityLimiter(limits(), period).limit(wanted, before, p)
    after = p + period * v
    assert np.linalg.norm(v) <= SPEED * (1 + ROUNDING)
    assert (after >= np.minimum(LOW, p) - 1e-15).all()
    assert (after <= np.maximum(HIGH, p) + 1e-15).all()


@settings(max_examples=200, deadline=None)
@given(shares, shares, shares)
def test_within_all_limits_the_velocity_is_the_one_wanted_to_the_last_bit(place, first, second):
    # At 100 m/s^2 and 10 ms, a change of 1 m/s, and 2 mm are enough to stop.
    limiter = VelocityLimiter(limits(100.0), 0.01)
    p = LOW + 0.002 + place * (HIGH - LOW - 0.004)
    before, wanted = ((2 * share - 1) * SPEED / np.sqrt(3) for share in (first, second))
    np.testing.assert_array_equal(limiter.limit(wanted, before, p), wanted)


def test_a_velocity_too_large_keeps_its_direction():
    limiter = VelocityLimiter(limits(100.0), 0.1)
    for size in (1.0, 1e150, 1e307):
        v = limiter.limit(size * np.array([3.0, -4.0, 0.0]), np.zeros(3), np.array([0.0, 0.0, 0.05]))
        np.testing.assert_allclose(v, [0.12, -0.16, 0.0], rtol=1e-12)


def test_the_change_towards_the_velocity_wanted_is_the_largest_allowed():
    limiter = VelocityLimiter(limits(0.5), 0.1)
    before = np.array([0.1, 0.0, 0.0])
    v = limiter.limit(np.array([-0.02, 0.16, 0.0]), before, np.array([0.0, 0.0, 0.05]))
    # 0.2 m/s away, of which 0.05 m/s are allowed: a quarter of the way.
    np.testing.assert_allclose(v, [0.07, 0.04, 0.0], atol=1e-12)


def test_it_brakes_in_time_and_stops_at_the_wall():
    period, acceleration = 0.005, 0.5
    limiter = VelocityLimiter(limits(acceleration), period)
    p, v, path = np.array([0.2, 0.0, 0.05]), np.zeros(3), []
    for _ in range(600):
        v = limiter.limit(np.array([SPEED, 0.0, 0.0]), v, p)
        p = p + period * v
        path.append([p[0], v[0]])
    x, speed = np.array(path).T
    assert x[-1] == pytest.approx(HIGH[0], abs=1e-9)
    assert abs(speed[-1]) < 1e-9
    # v^2 / 2 a from the wall it begins to brake, with a = 0.5 / sqrt(3), and a period's way earlier or later.
    begins = x[np.flatnonzero(speed == speed.max())[-1]]
    expected = HIGH[0] - speed.max() ** 2 / (2 * acceleration / np.sqrt(3))
    assert abs(begins - expected) < 2 * SPEED * period


def test_a_period_that_is_none_is_refused():
    with pytest.raises(ParameterError, match="period: got 0"):
        VelocityLimiter(limits(), 0.0)
