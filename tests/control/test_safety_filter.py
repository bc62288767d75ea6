# SPDX-License-Identifier: MIT
import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pinwm_drake.control.safety_filter import Safety, SafetyFilter
from pinwm_drake.errors import ParameterError, StateError
from pinwm_drake.learning.safety import SafetyLimits
from pinwm_drake.tasks.push import PushTask

LOW, HIGH = np.array([-0.3, -0.2, 0.0]), np.array([0.3, 0.2, 0.1])
LIMITS = SafetyLimits(tuple(LOW), tuple(HIGH), 0.2, 1.0, 0.1, box_tolerance=0.005)
H, SIZE = 0.1, (24, 32)
MIDDLE = np.array([0.0, 0.0, 0.05, 0.0, 0.0, 0.0])
FILTER = SafetyFilter(LIMITS, H, SIZE, PushTask())

# Finite ones whose quotient by H is none are a fault too, and tested below.
anything = st.floats(-1e299, 1e299) | st.sampled_from([np.nan, np.inf, -np.inf]) | st.floats(-0.05, 0.05)
# Now and then something is wrong: an offset of the image's time, and one of the pusher.
ages = st.sampled_from([0.0] * 8 + [0.09, 0.2, -0.2, np.nan, np.inf, -np.inf])
offsets = st.sampled_from([0.0] * 8 + [-0.7, np.nan, np.inf])
events = st.tuples(
    st.lists(anything, min_size=2, max_size=2) | st.sampled_from([[0.02, 0.0], [-0.02, 0.01], []]),
    ages,
    offsets,
    st.sampled_from([""] * 12 + ["arm", "arm", "disarm", "reset"]),
)


@settings(max_examples=300, deadline=None)
@given(st.lists(events, max_size=40), st.tuples(*[st.floats(0.0, 1.0)] * 3).map(np.array))
def test_no_limit_is_exceeded_and_no_fault_moves_whatever_comes_in(chain, share):
    safety, pusher = Safety(), np.concatenate([LOW + share * (HIGH - LOW), np.zeros(3)])
    latched = False
    for k, (d, age, offset, order) in enumerate(chain):
        if order == "reset":
            safety, latched = Safety(), False
        elif order == "disarm":
            safety = FILTER.disarm(safety)
        elif order == "arm" and latched:
            with pytest.raises(StateError, match="reset it first"):
                FILTER.arm(safety)
        elif order == "arm":
            safety = FILTER.arm(safety)
        before, armed = safety, safety.mode in ("armed", "running")
        seen = pusher + offset
        fault = FILTER.fault(k * H, k * H - age, seen)
        safety = FILTER.watch(safety, fault) if fault else FILTER.act(safety, np.array(d), seen[:3])
        right = len(d) == 2 and all(abs(value) < 1e300 for value in d)
        assert (fault == "") == (offset == 0.0 and 0.0 <= age <= LIMITS.max_image_age)
        assert (FILTER.action_fault(np.array(d)) == "") == right
        latched = latched or (armed and (fault != "" or not right))
        assert (safety.mode == "latched") == latched
        v = np.array(safety.v_WP)
        assert np.isfinite(v).all()
        if latched or not armed:
            assert (v == 0.0).all()
        if latched:
            assert safety.reason
            continue
        assert np.linalg.norm(v) <= LIMITS.max_speed * (1 + 2e-9)
        assert np.linalg.norm(v - before.v_WP) <= LIMITS.max_acceleration * H * (1 + 2e-9)
        pusher[:3] += H * v
        assert (pusher[:3] >= LOW - 1e-13).all()
        assert (pusher[:3] <= HIGH + 1e-13).all()


FAULTS = [
    ({"image_time": 4.89}, r"image is stale: 0\.110 s old; allowed: 0\.1 s"),
    ({"image_time": 5.01}, "image is from the future"),
    ({"image_time": np.nan}, "image's time is not finite: nan"),
    ({"image_time": -np.inf}, "image's time is not finite"),
    ({"last_image_time": 5.1}, "older than the last one; a new episode needs a reset"),
    ({"pusher_state": np.r_[np.nan, MIDDLE[1:]]}, "pusher's state is lost"),
    ({"pusher_state": np.r_[MIDDLE[:5], np.inf]}, "pusher's state is lost"),
    ({"pusher_state": MIDDLE[:3]}, "pusher's state is lost"),
    ({"pusher_state": np.r_[0.0, 0.206, 0.05, np.zeros(3)]}, r"pusher is 6\.0 mm outside of its box"),
    ({"pusher_state": np.r_[0.0, 0.0, -0.01, np.zeros(3)]}, r"pusher is 10\.0 mm outside of its box"),
]


@pytest.mark.parametrize(("wrong", "words"), FAULTS)
def test_every_fault_of_what_comes_in_latches_and_tells(wrong, words):
    values = {"image_time": 5.0, "pusher_state": MIDDLE, "last_image_time": 4.9}
    assert FILTER.fault(5.0, **values) == ""
    fault = FILTER.fault(5.0, **(values | wrong))
    assert re.search(words, fault)
    running = FILTER.act(FILTER.arm(Safety()), np.array([0.01, 0.0]), MIDDLE[:3])
    assert running.v_WP == pytest.approx((0.1, 0.0, 0.0))
    latched = FILTER.watch(running, fault)
    assert latched == Safety("latched", fault)
    # Neither what is right again, nor arming, nor disarming, nor another fault makes it go on.
    for after in (
        FILTER.watch(latched, ""),
        FILTER.watch(latched, "another"),
        FILTER.act(latched, np.array([0.01, 0.0]), MIDDLE[:3]),
        FILTER.disarm(latched),
    ):
        assert after == latched
    with pytest.raises(StateError, match="stopped by a fault"):
        FILTER.arm(latched)


@pytest.mark.parametrize("d", [[np.nan, 0.0], [0.0, np.inf], [-np.inf, 0.0], [1e308, 0.0], [0.0], [0.0] * 3, 0.0])
def test_every_fault_of_an_action_latches(d):
    latched = FILTER.act(FILTER.arm(Safety()), np.array(d), MIDDLE[:3])
    assert latched.mode == "latched"
    assert latched.reason.startswith("action ")
    told = FILTER.act(Safety(), np.array(d), MIDDLE[:3])
    assert (told.mode, told.v_WP) == ("disarmed", (0.0, 0.0, 0.0))
    assert told.reason == latched.reason


def test_an_image_of_another_size_is_a_fault():
    assert FILTER.image_fault(np.zeros((24, 32, 4), np.uint8)) == ""
    assert FILTER.image_fault(np.zeros((32, 24, 4), np.uint8)) == "image has 24 by 32 px; allowed: 32 by 24"
    assert "float64" in FILTER.image_fault(np.zeros((24, 32, 4)))
    assert "(24, 32)" in FILTER.image_fault(np.zeros((24, 32), np.uint8))


def test_just_at_the_limits_there_is_no_fault():
    at_wall = np.r_[HIGH + 0.0049, np.zeros(3)]
    assert FILTER.fault(5.0, 4.9, at_wall, last_image_time=4.9) == ""


def test_nothing_moves_before_it_is_armed():
    safety = FILTER.act(Safety(), np.array([0.01, 0.0]), MIDDLE[:3])
    assert safety == Safety()
    armed = FILTER.arm(safety)
    assert (armed.mode, armed.v_WP) == ("armed", (0.0, 0.0, 0.0))
    running = FILTER.act(armed, np.array([0.01, 0.0]), MIDDLE[:3])
    assert (running.mode, running.limited) == ("running", False)
    assert FILTER.arm(running) == running
    assert FILTER.disarm(running) == Safety()
    # 0.2 m/s at most, and 0.1 m/s more than before.
    fast = FILTER.act(running, np.array([1.0, 0.0]), MIDDLE[:3])
    assert fast.v_WP == pytest.approx((0.2, 0.0, 0.0))
    assert fast.limited


@pytest.mark.parametrize("limits", [None, {}, 0.2])
def test_there_is_no_filter_without_limits(limits):
    with pytest.raises(ParameterError, match="limits: got a"):
        SafetyFilter(limits, H, SIZE, PushTask())
    with pytest.raises(TypeError):
        SafetyFilter(horizon=H, image_size=SIZE, task=PushTask())
