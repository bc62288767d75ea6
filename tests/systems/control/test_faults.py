# SPDX-License-Identifier: MIT
"""A controller by itself: what it sees, its limits, and every fault."""

import dataclasses

import numpy as np
import pytest
from pydrake.common.value import AbstractValue
from pydrake.systems.analysis import Simulator
from pydrake.systems.sensors import ImageRgba8U

from pinwm_drake.errors import ParameterError, StateError
from pinwm_drake.learning.safety import default_limits
from pinwm_drake.systems.control.controller import ControlStatus, PolicyController
from tests.systems.policies import SIZE, Follower, small_setup, spec_of
from tests.systems.stations import HIGH

H, LOOK = 0.1, 0.02


class Bench:
    """A controller whose inputs are fixed values; every 20 ms it looks for faults, every 100 ms it acts."""

    def __init__(self, frames=2):
        self.spec = spec_of(small_setup(), frames)
        self.policy = Follower(self.spec)
        self.limits = dataclasses.replace(default_limits(self.spec), max_image_age=H)
        self.controller = PolicyController(self.policy, self.limits, LOOK)
        self.simulator = Simulator(self.controller)
        self.context = self.simulator.get_mutable_context()
        self.give(0.0)

    def give(self, t, *, age=0.0, pusher=(0.0, 0.0, 0.025, 0.0, 0.0, 0.0), size=(SIZE, SIZE), shade=100):
        image = ImageRgba8U(*size)
        image.mutable_data[:] = 255
        image.mutable_data[4:9, 20:24, :3] = shade
        ports = self.controller.GetInputPort
        ports("rgb").FixValue(self.context, AbstractValue.Make(image))
        ports("rgb_time").FixValue(self.context, [t - age])
        ports("pusher_state").FixValue(self.context, pusher)

    def run(self, t, **wrong):
        """Looks and acts at t, with inputs of that time."""
        t = round(t / LOOK) * LOOK  # to the last bit, so that nothing is due a rounding error before
        if t > 0.0:
            self.simulator.AdvanceTo(t)
        self.give(t, **wrong)
        self.simulator.AdvanceTo(t + 0.001)

    def output(self, name):
        return self.controller.GetOutputPort(name).Eval(self.context)


FAULTS = [
    ({"age": 0.2}, "image is stale: 0.200 s old; allowed: 0.1 s"),
    ({"age": -0.01}, "image is from the future: 0.010000 s ahead"),
    ({"age": np.nan}, "image's time is not finite: nan"),
    ({"pusher": (0, np.nan, 0.025, 0, 0, 0)}, "pusher's state is lost: [0, nan, 0.025, 0, 0, 0]"),
    ({"pusher": (0, 0, 0.025, np.nan, 0, 0)}, "pusher's state is lost: [0, 0, 0.025, nan, 0, 0]"),
    ({"pusher": (HIGH[0] + 0.01, 0, 0.025, 0, 0, 0)}, "pusher is 10.0 mm outside of its box, at [0.41, 0, 0.025] m"),
    ({"size": (SIZE, SIZE - 1)}, "image has 32 by 31 px; allowed: 32 by 32"),
    ({"policy": [np.nan, 0.0]}, "action is not finite: [nan, 0] m"),
    ({"policy": [0.0, np.inf]}, "action is not finite: [0, inf] m"),
    ({"policy": [0.0, 0.0, 0.0]}, "action has shape (3,); allowed: (2,)"),
    ({"policy": ["left"]}, "policy failed: ValueError"),
]


@pytest.mark.parametrize(("wrong", "words"), FAULTS)
def test_every_fault_latches_until_a_reset(wrong, words, monkeypatch):
    bench = Bench()
    bench.controller.Arm(bench.context)
    bench.run(0.0)
    assert np.linalg.norm(bench.output("pusher_velocity_W")) == pytest.approx(0.2)
    with monkeypatch.context() as patch:
        if "policy" in wrong:
            patch.setattr(bench.policy, "act", lambda *_: wrong["policy"], raising=False)
        bench.run(0.1, **{name: value for name, value in wrong.items() if name != "policy"})
    status = bench.output("status")
    assert status.state == "latched"
    assert status.reason.startswith(words)
    np.testing.assert_array_equal(bench.output("pusher_velocity_W"), np.zeros(3))
    # All is well again, but it stays.
    for t in (0.12, 0.2, 0.3):
        bench.run(t)
        np.testing.assert_array_equal(bench.output("pusher_velocity_W"), np.zeros(3))
        assert bench.output("status").state == "latched"
        assert bench.output("status").reason == status.reason
    bench.controller.Disarm(bench.context)
    with pytest.raises(StateError, match="stopped by a fault"):
        bench.controller.Arm(bench.context)
    bench.controller.Reset(bench.context)
    assert bench.output("status") == ControlStatus(
        time=bench.context.get_time(), image_age=bench.output("status").image_age
    )
    bench.run(0.4)
    np.testing.assert_array_equal(bench.output("pusher_velocity_W"), np.zeros(3))
    bench.controller.Arm(bench.context)
    bench.run(0.5)
    assert np.linalg.norm(bench.output("pusher_velocity_W")) > 0.0


@pytest.mark.parametrize(("wrong", "words"), FAULTS[:6])
def test_faults_of_times_and_pusher_need_not_wait_for_the_next_action(wrong, words):
    bench = Bench()
    bench.controller.Arm(bench.context)
    bench.run(0.0)
    bench.run(0.04, **wrong)
    assert bench.output("status").state == "latched"
    assert bench.output("status").reason == words
    assert bench.policy.asked == 1


@pytest.mark.parametrize(("wrong", "words"), FAULTS[:7])
def test_disarmed_a_fault_is_told_and_forgotten(wrong, words):
    bench = Bench()
    bench.run(0.0, **wrong)
    assert (bench.output("status").state, bench.output("status").reason) == ("disarmed", words)
    assert np.isnan(bench.output("raw_action")).all()
    bench.run(0.1)
    assert (bench.output("status").state, bench.output("status").reason) == ("disarmed", "")


def test_an_exception_outside_of_the_policy_latches(monkeypatch):
    bench = Bench()
    bench.controller.Arm(bench.context)
    bench.run(0.0)

    def fail(*_):
        raise RuntimeError("on purpose")

    monkeypatch.setattr(bench.controller._pilot, "look", fail)
    bench.run(0.04)
    assert bench.output("status").state == "latched"
    assert bench.output("status").reason == "controller failed: RuntimeError: on purpose"
    np.testing.assert_array_equal(bench.output("pusher_velocity_W"), np.zeros(3))


def test_an_image_older_than_the_last_is_a_fault():
    bench = Bench()
    bench.controller.Arm(bench.context)
    bench.run(0.0)
    bench.run(0.1)
    bench.run(0.12, age=0.03)
    assert "older than the last one" in bench.output("status").reason


def test_it_sees_the_last_images_and_the_first_for_those_before():
    bench, seen = Bench(frames=3), []
    bench.policy.act = lambda image, p_WP: seen.append(image[4, 20, ::3].tolist()) or np.zeros(2)
    for k, shade in enumerate((10, 20, 30, 40)):
        bench.run(k * H, shade=shade)
    assert seen == [[10, 10, 10], [10, 10, 20], [10, 20, 30], [20, 30, 40]]
    bench.controller.Reset(bench.context)
    bench.run(4 * H, shade=50)
    assert seen[-1] == [50, 50, 50]


def test_the_change_of_velocity_is_limited():
    bench = Bench()
    slow = dataclasses.replace(bench.limits, max_acceleration=0.5)
    bench.controller = PolicyController(bench.policy, slow, LOOK)
    bench.simulator = Simulator(bench.controller)
    bench.context = bench.simulator.get_mutable_context()
    bench.give(0.0)
    bench.controller.Arm(bench.context)
    for k in range(6):
        bench.run(k * H)
        speed = np.linalg.norm(bench.output("pusher_velocity_W"))
        assert speed == pytest.approx(min(0.05 * (k + 1), 0.2))
        assert bench.output("status").limited == (k < 3)


def test_nothing_depends_on_the_inputs_directly():
    assert not Bench().controller.HasAnyDirectFeedthrough()


def test_there_is_no_controller_without_limits():
    policy = Bench().policy
    with pytest.raises(TypeError, match="limits"):
        PolicyController(policy)
    with pytest.raises(ParameterError, match="limits: got a NoneType"):
        PolicyController(policy, None)
