# SPDX-License-Identifier: MIT
import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydrake.common.value import AbstractValue
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.sensors import ImageRgba8U

from pinwm_drake.errors import ParameterError, StateError
from pinwm_drake.learning.safety import SafetyLimits, default_limits
from pinwm_drake.systems.arm.interpolator import CommandInterpolator
from pinwm_drake.systems.control.controller import PolicyController
from tests.systems.policies import SIZE, Follower, small_setup, spec_of

LOW, HIGH = np.array([-0.3, -0.2, 0.0]), np.array([0.3, 0.2, 0.1])
LIMITS = SafetyLimits(tuple(LOW), tuple(HIGH), 0.2, 2.0, 0.1, max_command_age=0.25, max_lag=0.03)
T, START = 0.005, np.array([0.1, 0.0, 0.05])


class Stream:
    """An interpolator whose inputs are set by hand, and the samples that come out."""

    def __init__(self, limits=LIMITS, start=START, stamp=-1.0):
        self.system = CommandInterpolator(limits)
        self.simulator = Simulator(self.system)
        self.context = self.simulator.get_mutable_context()
        self.count, self.stamp, self.desired, self.live = 0, stamp, [], []
        self.held = None  # where something holds the pusher
        self.command(np.zeros(3), stamp)
        self.measure(start)
        self.simulator.Initialize()

    def command(self, v_WP, stamp=None):
        self.stamp = self.stamp + 0.1 if stamp is None else stamp
        self.system.GetInputPort("pusher_velocity_W").FixValue(self.context, v_WP)
        self.system.GetInputPort("command_time").FixValue(self.context, [self.stamp])

    def measure(self, p_WP):
        self.system.GetInputPort("pusher_state").FixValue(self.context, [*p_WP, 0.0, 0.0, 0.0])

    def run(self, samples):
        """(samples, 6) that come, while the pusher is measured where it is to be, or where it is held."""
        for _ in range(samples):
            # The sample of this time is taken on the way to half a period later.
            self.simulator.AdvanceTo((self.count + 0.5) * T)
            self.count += 1
            self.desired.append(self.system.GetOutputPort("desired_state").Eval(self.context).copy())
            self.live.append(float(self.system.GetOutputPort("live").Eval(self.context)[0]))
            if self.held is None:
                self.measure(self.desired[-1][:3])
        return np.array(self.desired[-samples:])


def check(samples, start=START, v=(0.0, 0.0, 0.0), limits=LIMITS):
    """Positions, speeds and accelerations of samples (n, 6) are within their limits, and belong together."""
    p = np.vstack([start, samples[:, :3]])
    v = np.vstack([v, samples[:, 3:]])
    np.testing.assert_allclose(np.diff(p, axis=0), T * v[:-1], atol=1e-15)
    assert (np.linalg.norm(v, axis=1) <= limits.max_speed * (1 + 2e-9)).all()
    assert (np.linalg.norm(np.diff(v, axis=0), axis=1) <= limits.max_acceleration * T * (1 + 2e-9)).all()
    # A thousand sums of numbers of the size of the box.
    assert (p >= LOW - 1e-13).all()
    assert (p <= HIGH + 1e-13).all()


def test_it_streams_200_samples_a_second_on_the_way_to_the_velocity_commanded():
    stream = Stream()
    stream.run(4)
    stream.command([0.0, 0.1, 0.0])
    samples = stream.run(20)
    check(samples, start=START)
    # 2 m/s^2 and 5 ms: 10 mm/s more with every sample, the first at once.
    np.testing.assert_allclose(samples[:, 4], np.minimum(0.01 * np.arange(1, 21), 0.1), atol=1e-12)
    np.testing.assert_allclose(samples[:, [3, 5]], 0.0, atol=1e-15)
    assert stream.live[:5] == [0.0, 0.0, 0.0, 0.0, 1.0]


def test_it_slows_down_to_rest_when_commands_stop_coming():
    stream = Stream()
    stream.command([0.1, 0.0, 0.0])
    samples = stream.run(200)
    check(samples)
    t = T * np.arange(200)
    moving = samples[:, 3] > 1e-12
    # The command of 0 s holds until 0.25 s, and then 0.1 m/s takes 50 ms at 2 m/s^2.
    np.testing.assert_allclose(samples[t < 0.2525, 3][10:], 0.1, atol=1e-12)
    assert t[moving].max() == pytest.approx(0.295)
    np.testing.assert_array_equal(np.array(stream.live) == 1.0, t < 0.2525)
    # The same command with another stamp is a new one.
    stream.command([0.1, 0.0, 0.0])
    assert stream.run(30)[-1, 3] == pytest.approx(0.1)


def test_commands_that_come_in_time_keep_it_going():
    stream = Stream(start=[-0.2, 0.0, 0.05])
    for _ in range(10):
        stream.command([0.04, 0.0, 0.0])
        stream.run(20)
    assert all(stream.live)
    # 1 s at 0.04 m/s, but for the 20 ms in which it got that fast.
    assert stream.desired[-1][0] + T * stream.desired[-1][3] == pytest.approx(-0.2 + 0.04 - 0.04 * 0.015 / 2, abs=1e-12)


def test_a_command_from_before_the_beginning_is_none():
    stream = Stream(stamp=5.0)
    stream.command([0.1, 0.0, 0.0], stamp=5.0)
    samples = stream.run(20)
    np.testing.assert_array_equal(samples[:, 3:], np.zeros((20, 3)))
    stream.command([0.1, 0.0, 0.0], stamp=3.0)  # of any clock, even one that was set back
    assert stream.run(20)[-1, 3] == pytest.approx(0.1)


@pytest.mark.parametrize("wrong", [[np.nan, 0.0, 0.0], [0.1, np.inf, 0.0], [0.1, 0.0, -np.inf]])
def test_a_command_that_is_no_number_slows_it_down(wrong):
    stream = Stream()
    stream.command([0.1, 0.0, 0.0])
    samples = [stream.run(20)]
    stream.command(wrong)
    samples.append(stream.run(20))
    check(np.vstack(samples))
    assert samples[0][-1, 3] == pytest.approx(0.1)
    np.testing.assert_allclose(samples[1][-1, 3:], 0.0, atol=1e-15)


def test_a_stamp_that_is_no_number_is_no_command():
    stream = Stream()
    stream.command([0.1, 0.0, 0.0])
    for stamp in (np.nan, stream.stamp, np.nan, stream.stamp, np.inf):
        stream.run(20)
        stream.command([0.1, 0.0, 0.0], stamp=stamp)
    stream.run(20)
    # 0.6 s, of which the only command was good for 0.25 s.
    assert sum(stream.live) == 51


def test_a_lost_pusher_slows_it_down():
    stream = Stream()
    stream.command([0.1, 0.0, 0.0])
    stream.run(20)
    stream.held = np.full(3, np.nan)
    stream.measure(stream.held)
    np.testing.assert_allclose(stream.run(20)[-1, 3:], 0.0, atol=1e-15)


def test_a_pusher_that_is_held_is_led_no_farther_away():
    stream = Stream()
    stream.held = START
    for _ in range(10):
        stream.command([0.1, 0.0, 0.0])
        stream.run(20)
    lag = stream.desired[-1][0] - START[0]
    # It brakes from 0.1 m/s at 2 m/s^2 beyond 30 mm: 2.5 mm, and a sample's 0.5 mm.
    assert 0.03 < lag < 0.0335
    # Back, and aside, it may go.
    stream.command([0.1, 0.05, 0.0])
    assert stream.run(20)[-1, 4] == pytest.approx(0.05, abs=0.02)
    stream.command([-0.1, 0.0, 0.0])
    assert stream.run(20)[-1, 3] == pytest.approx(-0.1)


def test_it_brakes_before_a_wall():
    stream = Stream(start=[0.2, 0.0, 0.05])
    for _ in range(20):
        stream.command([0.2, 0.0, 0.0])
        stream.run(20)
    samples = np.array(stream.desired)
    check(samples, start=np.array([0.2, 0.0, 0.05]))
    assert samples[-1, 0] == pytest.approx(HIGH[0], abs=1e-9)


def test_what_a_controller_sends_is_streamed_from_its_own_instant_and_a_fault_slows_it_down():
    policy = Follower(spec_of(small_setup()))
    builder = DiagramBuilder()
    controller = builder.AddSystem(PolicyController(policy, default_limits(policy.spec), 0.02))
    interpolator = builder.AddSystem(CommandInterpolator(LIMITS))
    for name in ("pusher_velocity_W", "command_time"):
        builder.Connect(controller.GetOutputPort(name), interpolator.GetInputPort(name))
    for name in ("rgb", "rgb_time", "pusher_state"):
        builder.ExportInput(controller.GetInputPort(name), name)
    builder.ConnectInput("pusher_state", interpolator.GetInputPort("pusher_state"))
    diagram = builder.Build()
    simulator = Simulator(diagram)
    context = simulator.get_mutable_context()
    image = ImageRgba8U(SIZE, SIZE)
    image.mutable_data[:] = 100
    diagram.GetInputPort("rgb").FixValue(context, AbstractValue.Make(image))
    diagram.GetInputPort("rgb_time").FixValue(context, [0.0])
    diagram.GetInputPort("pusher_state").FixValue(context, [0.02, 0.01, 0.025, 0.0, 0.0, 0.0])
    controller.Arm(context)
    speeds = []
    for k in range(60):
        simulator.AdvanceTo((k + 0.5) * T)
        desired = interpolator.GetOutputPort("desired_state").Eval(interpolator.GetMyContextFromRoot(context))
        speeds.append(np.linalg.norm(desired[3:]))
    # At t = 0 already; at 0.1 s no other image has come than that of t = 0.
    np.testing.assert_allclose(speeds[:20], np.minimum(0.01 * np.arange(1, 21), 0.2), atol=1e-12)
    np.testing.assert_allclose(speeds[20:], np.maximum(0.2 - 0.01 * np.arange(1, 41), 0.0), atol=1e-12)
    assert controller.status(context).state == "latched"
    assert interpolator.GetOutputPort("live").Eval(interpolator.GetMyContextFromRoot(context)) == 1.0


numbers = st.floats(allow_nan=True, allow_infinity=True) | st.floats(-0.3, 0.3)
commands = st.tuples(st.lists(numbers, min_size=3, max_size=3), st.sampled_from([None, None, 7.0, np.nan]))


@settings(max_examples=40, deadline=None)
@given(st.lists(commands, max_size=8), st.sampled_from([0.3, 2.0, 50.0]), st.tuples(*[st.floats(0, 1)] * 3))
def test_no_limit_is_exceeded_whatever_is_commanded(chain, acceleration, share):
    start, limits = LOW + np.array(share) * (HIGH - LOW), dataclasses.replace(LIMITS, max_acceleration=acceleration)
    stream = Stream(limits, start)
    for v_WP, stamp in chain:
        stream.command(v_WP, stamp)
        stream.stamp = 0.0 if np.isnan(stream.stamp) else stream.stamp
        stream.run(13)
    if chain:
        check(np.array(stream.desired), start, limits=limits)


def test_it_begins_where_the_pusher_is_and_only_if_that_is_known():
    with pytest.raises(StateError, match=r"pusher_state: got \[nan, 0\.0, 0\.0\] m at the beginning"):
        Stream(start=[np.nan, 0.0, 0.0])
    stream = Stream()
    stream.command([0.1, 0.0, 0.0])
    stream.run(20)
    stream.measure([0.0, 0.1, 0.05])
    stream.simulator.Initialize()
    np.testing.assert_array_equal(
        stream.system.GetOutputPort("desired_state").Eval(stream.context), [0.0, 0.1, 0.05, 0.0, 0.0, 0.0]
    )


def test_nothing_depends_on_the_inputs_directly():
    system = CommandInterpolator(LIMITS)
    assert not system.HasAnyDirectFeedthrough()
    assert system.period == 1 / 200


@pytest.mark.parametrize("period", [0.0, -1.0, np.nan, 0.25])
def test_a_period_out_of_range_is_refused(period):
    with pytest.raises(ParameterError, match="period: got"):
        CommandInterpolator(LIMITS, period)
