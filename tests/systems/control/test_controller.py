# SPDX-License-Identifier: MIT
import dataclasses

import numpy as np
import pytest
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from pinwm_drake.errors import ParameterError
from pinwm_drake.learning.safety import default_limits
from pinwm_drake.systems.control.controller import AddPolicyController, PolicyController
from pinwm_drake.systems.envs.env import TaskEnv
from pinwm_drake.systems.scenario.start import Place
from pinwm_drake.systems.station.station import make_station
from tests.systems.policies import LONGEST, Follower, small_setup, spec_of

H, ACTIONS = 0.1, 12
# The pusher stands before the stem; it gets there, and turns the block while it is on the way.
PLACE = Place(RigidTransform(RollPitchYaw(0.0, 0.0, 0.4), [0.02, -0.03, 0.025]), np.array([0.06, 0.12, 0.025]))


class Loop:
    """A station and a controller."""

    def __init__(self, setup, engine="twin", limits=None):
        builder = DiagramBuilder()
        self.policy = Follower(spec_of(setup))
        self.limits = limits or default_limits(self.policy.spec)
        self.station = builder.AddSystem(make_station(setup, engine))
        self.controller = AddPolicyController(builder, self.station, self.policy, self.limits)
        self.diagram = builder.Build()
        self.simulator = Simulator(self.diagram)
        self.context = self.simulator.get_mutable_context()
        self.station.SetPlace(self.context, PLACE)
        self.updates = round(H / setup.period)
        self.period = setup.period

    def run_to(self, action):
        """Up to the end of an action, as a time that is one of the station's updates to the last bit."""
        self.simulator.AdvanceTo(action * self.updates * self.period)
        return self.state()

    def state(self):
        """(19,): object and pusher."""
        mine = self.station.GetMyContextFromRoot(self.context)
        names = ("object_state", "pusher_state")
        return np.concatenate([self.station.GetOutputPort(name).Eval(mine) for name in names])

    def output(self, name):
        return self.controller.GetOutputPort(name).Eval(self.controller.GetMyContextFromRoot(self.context))


def in_environment(setup, engine="twin"):
    """The path (ACTIONS, 16) of object and pusher, and the actions (ACTIONS, 2) m, in TaskEnv."""
    env = TaskEnv(setup, engine, observation="rgb", frames=2, max_translation=LONGEST)
    policy, path, actions = Follower(spec_of(env.setup)), [], []
    seen = env.reset(options={"place": PLACE})[0]
    for _ in range(ACTIONS):
        # The observation has the pusher in float32; the station has it in float64.
        p_WP = env.run.p_WP[0, :2].copy()
        half = 0.5 * (np.array(policy.spec.pusher_high) - policy.spec.pusher_low)
        middle = 0.5 * (np.array(policy.spec.pusher_high) + policy.spec.pusher_low)
        np.testing.assert_allclose(seen["pusher"] * half + middle, p_WP, atol=1e-7)
        action = policy.action(seen["image"], p_WP)
        actions.append(env.task.translation(action, LONGEST)[0, :2])
        seen = env.step(action)[0]
        path.append(np.concatenate([env.run.object_state[0], env.run.p_WP[0]]))
    return np.array(path), np.array(actions)


@pytest.mark.parametrize(("engine", "steps"), [("twin", 1), ("twin", 24), ("point", 1)])
def test_in_a_station_it_decides_as_in_the_environment(engine, steps):
    setup = small_setup(steps)
    expected, actions = in_environment(small_setup(1), engine)
    loop = Loop(setup, engine)
    loop.controller.Arm(loop.context)
    path = []
    for k in range(ACTIONS):
        path.append(loop.run_to(k + 1)[:16])
        # The action of k H was on the image of k H: one that is late would be the action before.
        np.testing.assert_array_equal(loop.output("raw_action"), actions[k])
    # Every number that goes into the physics is the same to the last bit. With an update for each of its steps, the
    # state is rounded in between: measured 2e-23, of speeds at rest.
    np.testing.assert_allclose(path, expected, rtol=0.0, atol=0.0 if steps == 1 else 1e-12)
    assert np.abs(expected[-1, 4:6] - PLACE.X_WO.translation()[:2]).max() > 0.005, "the object was not pushed"
    assert loop.policy.asked == ACTIONS
    status = loop.output("status")
    assert (status.state, status.reason, status.actions, status.limited) == ("running", "", ACTIONS, False)
    assert status.time == pytest.approx((ACTIONS - 1) * H)
    assert status.image_age == 0.0
    assert loop.output("command_time")[0] == status.time


@pytest.fixture(scope="module")
def shared_loop():
    return Loop(small_setup(24))


@pytest.fixture
def loop(shared_loop):
    """At the beginning of an episode, disarmed."""
    shared_loop.context.SetTime(0.0)
    shared_loop.station.SetPlace(shared_loop.context, PLACE)
    shared_loop.controller.Reset(shared_loop.context)
    shared_loop.simulator.Initialize()
    return shared_loop


def test_disarmed_it_computes_and_stands_still(loop):
    assert np.isnan(loop.output("raw_action")).all()
    loop.run_to(3)
    assert np.linalg.norm(loop.output("raw_action")) == pytest.approx(LONGEST)
    np.testing.assert_array_equal(loop.output("pusher_velocity_W"), np.zeros(3))
    np.testing.assert_array_equal(loop.state()[13:16], PLACE.p_WP)
    assert loop.output("status").state == "disarmed"
    assert loop.output("status").actions == 3


def test_it_moves_from_the_action_after_it_is_armed_until_it_is_disarmed(loop):
    loop.simulator.AdvanceTo(0.05)
    loop.controller.Arm(loop.context)
    assert loop.controller.status(loop.context).state == "armed"
    loop.run_to(1)
    np.testing.assert_array_equal(loop.state()[13:16], PLACE.p_WP)
    before = loop.run_to(2)[13:16]
    assert np.linalg.norm(before - PLACE.p_WP) == pytest.approx(LONGEST)
    loop.controller.Disarm(loop.context)
    np.testing.assert_array_equal(loop.output("pusher_velocity_W"), np.zeros(3))
    np.testing.assert_array_equal(loop.run_to(3)[13:16], before)


def test_a_fault_stops_the_pusher_in_the_station(loop, monkeypatch):
    loop.controller.Arm(loop.context)
    before = loop.run_to(2)[13:16]
    with monkeypatch.context() as patch:
        patch.setattr(loop.policy, "act", lambda *_: np.array([np.nan, 0.0]), raising=False)
        loop.run_to(3)
    after = loop.run_to(5)
    np.testing.assert_array_equal(after[13:16], before)
    np.testing.assert_array_equal(after[16:], np.zeros(3))
    status = loop.output("status")
    assert (status.state, status.reason) == ("latched", "action is not finite: [nan, 0] m")


def test_an_episode_after_a_reset_is_the_same_again(loop):
    paths = []
    for _ in range(2):
        loop.context.SetTime(0.0)
        loop.station.SetPlace(loop.context, PLACE)
        loop.controller.Reset(loop.context)
        loop.controller.Arm(loop.context)
        loop.simulator.Initialize()
        paths.append([loop.run_to(k) for k in range(1, 4)])
    np.testing.assert_array_equal(*paths)


def test_a_context_that_is_copied_goes_on_the_same(loop):
    loop.controller.Arm(loop.context)
    loop.run_to(2)
    simulator = Simulator(loop.diagram, loop.context.Clone())
    simulator.AdvanceTo(4 * loop.updates * loop.period)
    expected = loop.run_to(4)
    mine = loop.station.GetMyContextFromRoot(simulator.get_context())
    np.testing.assert_array_equal(loop.station.GetOutputPort("object_state").Eval(mine), expected[:13])


def test_at_the_wall_of_its_own_box_it_stops():
    setup = small_setup(1)
    spec = spec_of(setup)
    wall = PLACE.p_WP[1] - 0.03
    low = (*default_limits(spec).box_low[:1], wall, 0.015)
    loop = Loop(setup, limits=dataclasses.replace(default_limits(spec), box_low=low))
    loop.controller.Arm(loop.context)
    heights = [loop.run_to(k)[14] for k in range(1, 8)]
    assert min(heights) == pytest.approx(wall, abs=1e-12)
    assert loop.output("status").limited
    assert loop.output("status").state == "running"


def test_what_does_not_fit_together_is_refused():
    setup = small_setup(1)
    spec = spec_of(setup)
    limits = default_limits(spec)
    with pytest.raises(ParameterError, match=r"horizon: got 0\.1 s; allowed: a whole multiple"):
        PolicyController(Follower(spec), limits, 0.03)
    with pytest.raises(ParameterError, match="observes 'state'"):
        PolicyController(Follower(dataclasses.replace(spec, observes="state")), limits)
    builder = DiagramBuilder()
    station = builder.AddSystem(make_station(setup, "twin", command="translation"))
    with pytest.raises(ParameterError, match="command='velocity'"):
        AddPolicyController(builder, station, Follower(spec), limits)
    builder = DiagramBuilder()
    station = builder.AddSystem(make_station(setup, "twin"))
    other = dataclasses.replace(spec, camera=dataclasses.replace(spec.camera, width=64))
    with pytest.raises(ParameterError, match="camera: got 32 by 32 px"):
        AddPolicyController(builder, station, Follower(other), limits)
