# SPDX-License-Identifier: MIT
import dataclasses
import math

import numpy as np
import pytest
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from pinwm_drake.errors import ParameterError
from pinwm_drake.systems.envs.env import TaskEnv
from pinwm_drake.systems.mpc.controller import AddPushMpc, PushMpc
from pinwm_drake.systems.mpc.model import rotated
from pinwm_drake.systems.mpc.outline import Outline
from pinwm_drake.systems.mpc.path import Walk
from pinwm_drake.systems.mpc.planner import PushPlanner
from pinwm_drake.systems.mpc.policy import PushMpcPolicy, make_planner
from pinwm_drake.systems.scenario.start import Place
from pinwm_drake.systems.station.station import make_station
from pinwm_drake.tasks.push import PushTask
from tests.systems.stations import action_setup

LONGEST, SPEED = 0.03, 0.3  # m in an action, m/s
BOX = 0.35  # m, of the scenario, to either side
HEIGHT = 0.025  # m, of the block's middle, and of the pusher


@pytest.fixture(scope="module")
def setup():
    return action_setup("push_t", time_step=1 / 120)


@pytest.fixture(scope="module")
def policy(setup):
    return PushMpcPolicy(setup, PushTask())


@pytest.fixture(scope="module")
def body(policy):
    return policy.planner.body


@pytest.fixture(scope="module")
def env(setup):
    return TaskEnv(setup, "twin")


def object_state(pose, velocity=(0.0, 0.0, 0.0)):
    """(13,) of the block at x, y, yaw with their rates."""
    q_WO = RollPitchYaw(0.0, 0.0, pose[2]).ToQuaternion().wxyz()
    return np.array([*q_WO, pose[0], pose[1], HEIGHT, 0.0, 0.0, velocity[2], velocity[0], velocity[1], 0.0])


def test_actions_are_no_longer_than_allowed_and_stay_in_the_box(policy):
    planner, generator = policy.planner, np.random.default_rng(1)
    for _ in range(15):
        x = generator.uniform([-0.3, -0.3, -3, -0.2, -0.2, -3], [0.3, 0.3, 3, 0.2, 0.2, 3])
        p = x[:2] + generator.uniform(0.1, 0.3) * rotated(np.array([1.0, 0.0]), generator.uniform(-3, 3))
        d_W = planner.plan(x, p).d_W
        assert np.hypot(*d_W) <= LONGEST + 1e-12
        after, worst = p + d_W, np.maximum(np.abs(p), BOX)
        assert (np.abs(after) <= worst + 1e-12).all()


def test_an_object_that_will_rest_at_the_goal_is_left_alone(policy):
    v = 0.1
    x = np.array([-(v**2) / (2 * 0.03 * 9.81), 0.0, 0.0, v, 0.0, 0.0])
    plan = policy.planner.plan(x, x[:2] - np.array([0.1, 0.0]))
    assert plan.phase == "wait"
    np.testing.assert_array_equal(plan.d_W, 0.0)


def test_a_pusher_does_not_cross_the_way_of_a_moving_object(policy):
    body, box = policy.planner.body, BOX * np.ones(2)
    walk, outline, radius = Walk(body, LONGEST, -box, box), body.outline, body.radius
    x, rest = np.array([0.0, 0.0, 0.0, 0.3, 0.0, 0.0]), np.array([0.153, 0.0, 0.0])
    # Where the object will be, it is in nobody's way; where it is, it is.
    for p, end in (([0.02, -0.08], [0.02, 0.15]), ([0.075, -0.04], [0.0, -0.04]), ([0.075, -0.04], [0.075, -0.04])):
        d_W = walk.step(x, np.array(p), rest, np.array(end))
        for share in np.linspace(0.1, 1.0, 10):
            # It slows down by less than 2 mm in an action.
            places = p + share * d_W - [[share * 0.03, 0.0], [share * 0.028, 0.0]]
            assert outline.nearest(places)[0].min() > radius


def test_it_does_not_want_to_push_from_outside_of_the_box(policy):
    x = np.array([BOX - 0.03, 0.0, 0.0, 0.0, 0.0, 0.0])
    plan = policy.planner.plan(x, np.array([BOX - 0.2, 0.1]))
    assert (np.abs(policy.planner.program.start(x, plan.pushes[0])) <= BOX).all()


def test_a_plan_is_dropped_when_the_pusher_is_elsewhere(policy):
    planner, x = policy.planner, np.array([0.05, 0.03, 0.5, 0, 0, 0])
    p = np.array([0.05, 0.16])
    plan = planner.plan(x, p)
    assert plan.phase == "approach"
    kept, dropped = planner.plan(x, plan.p_WP, plan), planner.plan(x, np.array([0.2, -0.1]), plan)
    assert kept.pushes is plan.pushes
    assert dropped.pushes is not plan.pushes


# As a policy.


def test_an_observation_tells_what_the_state_does(setup, body):
    task = PushTask(goal=(0.1, -0.05, 0.7))
    policy = PushMpcPolicy(setup, task)
    policy.planner.body = dataclasses.replace(body, p_OB=np.array([0.01, -0.02]))
    state, p_WP = object_state((-0.07, 0.02, -2.9), (0.1, -0.2, 1.5)), np.array([0.12, 0.21, HEIGHT])
    row = task.state(state[None], p_WP[None])[0]
    x, p = policy.read(row.astype(float))
    np.testing.assert_allclose(x, policy.planner.body.planar(state), atol=1e-6)  # float32
    np.testing.assert_allclose(p, p_WP[:2], atol=1e-7)


def episode(env, policy, **options):
    """The last `info` of an episode."""
    observation, _ = env.reset(**options)
    state, done = None, False
    while not done:
        action, state = policy.predict(observation, state)
        assert env.action_space.contains(action)
        observation, _, success, truncated, info = env.step(action)
        done = success or truncated
    return info


@pytest.mark.parametrize("seed", [0, 1, 2, 3])
def test_it_pushes_the_object_to_the_goal(env, policy, seed):
    info = episode(env, policy, seed=seed)
    assert info["success"]
    assert info["step"] <= 40  # 20 in the mean


def test_it_does_not_put_off_a_push_again_and_again(env, policy):
    # From here the second push of two alone will do, and the first was made smaller and smaller.
    X_WO = RigidTransform(RollPitchYaw(0, 0, -1.7263), [0.0907, -0.0167, HEIGHT])
    assert episode(env, policy, seed=0, options={"X_WO": X_WO, "p_WP": [0.0961, 0.0242, HEIGHT]})["success"]


def test_worlds_are_planned_for_one_by_one(env, policy):
    rows = np.stack([env.reset(seed=seed)[0] for seed in (5, 6)])
    together, plans = policy.predict(rows)
    assert together.shape == (2, 2)
    for row, action in zip(rows, together, strict=True):
        np.testing.assert_array_equal(policy.predict({"state": row})[0], action)
    # What was planned in another episode is forgotten.
    again, fresh = policy.predict(rows, plans, episode_start=np.array([False, True]))
    assert fresh[0].pushes is not plans[0].pushes
    np.testing.assert_array_equal(again[1], together[1])
    rows[0, 3] = np.nan
    actions, plans = policy.predict(rows)
    np.testing.assert_array_equal(actions[0], 0.0)
    assert plans[0] is None


# As a Drake system.


def diagram_of(setup):
    builder = DiagramBuilder()
    station = builder.AddNamedSystem("station", make_station(setup, "twin"))
    return AddPushMpc(builder, station, setup, PushTask()), station, builder.Build()


def test_a_diagram_pushes_the_object_to_the_goal_as_the_environment_does(setup, env, policy):
    mpc, station, diagram = diagram_of(setup)
    simulator = Simulator(diagram)
    context = simulator.get_mutable_context()
    observation, _ = env.reset(seed=0)
    state = env.run.object_state[0]
    X_WO = RigidTransform(RollPitchYaw(0, 0, policy.planner.body.planar(state)[2]), state[4:7])
    station.SetPlace(context, Place(X_WO, env.run.p_WP[0]))
    action, _ = policy.predict(observation)
    simulator.AdvanceTo(setup.period / 2)
    velocity = mpc.GetOutputPort("pusher_velocity_W")
    # The observation is float32.
    np.testing.assert_allclose(velocity.Eval(mpc.GetMyContextFromRoot(context))[:2], SPEED * action, atol=1e-5)
    clone = context.Clone()
    for k in range(1, 40):
        simulator.AdvanceTo((k + 0.5) * setup.period)
        v = velocity.Eval(mpc.GetMyContextFromRoot(context))
        assert np.linalg.norm(v) <= SPEED + 1e-9
        assert v[2] == 0.0
    seen = station.GetOutputPort("object_state").Eval(station.GetMyContextFromRoot(context))
    assert PushTask().measure(seen[None], np.zeros((1, 3))).success[0]
    assert mpc.plan(context).phase == "wait"
    again = Simulator(diagram, clone)
    again.AdvanceTo(39.5 * setup.period)
    same = station.GetOutputPort("object_state").Eval(station.GetMyContextFromRoot(again.get_context()))
    np.testing.assert_array_equal(same, seen)


def test_a_system_plans_once_a_horizon_and_stops_where_a_number_is_none(setup):
    mpc = PushMpc(setup, PushTask(), period=setup.period / 4)
    context = mpc.CreateDefaultContext()
    seen, pusher = object_state((0.05, 0.03, 0.5)), np.array([0.05, 0.16, HEIGHT, 0, 0, 0])
    port = mpc.GetInputPort("object_state").FixValue(context, seen)
    mpc.GetInputPort("pusher_state").FixValue(context, pusher)
    simulator = Simulator(mpc, context)
    simulator.AdvanceTo(0.6 * setup.period)
    v = mpc.GetOutputPort("pusher_velocity_W").Eval(context).copy()
    assert np.linalg.norm(v) == pytest.approx(SPEED)
    shown = mpc.GetOutputPort("plan").Eval(context)
    np.testing.assert_array_equal(SPEED / LONGEST * shown.d_W, v[:2])
    port.GetMutableData().get_mutable_value().SetAtIndex(5, np.nan)
    simulator.AdvanceTo(0.9 * setup.period)
    np.testing.assert_array_equal(mpc.GetOutputPort("pusher_velocity_W").Eval(context), v)
    simulator.AdvanceTo(1.1 * setup.period)
    np.testing.assert_array_equal(mpc.GetOutputPort("pusher_velocity_W").Eval(context), 0.0)
    assert mpc.plan(context) is None


# What it refuses.


@pytest.mark.parametrize("length", [0.0, -0.01, 0.031, math.nan])
def test_a_translation_is_one_that_the_pusher_can_make(setup, length):
    with pytest.raises(ParameterError, match="max_translation"):
        make_planner(setup, PushTask(), length)


def test_an_object_that_is_to_lie_otherwise_is_refused(setup):
    with pytest.raises(ParameterError, match="q_WO"):
        PushMpcPolicy(setup, PushTask(q_WO=(1.0, 1.0, 0.0, 0.0)))


def test_an_object_without_a_side_to_push_is_refused(setup, body):
    small = dataclasses.replace(body, outline=Outline(0.05 * body.outline.corners))
    with pytest.raises(ParameterError, match="longest side is 5"):
        PushPlanner(small, PushTask(), LONGEST, np.array([-BOX, -BOX]), np.array([BOX, BOX]))


def test_a_period_that_does_not_divide_the_horizon_is_refused(setup):
    with pytest.raises(ParameterError, match="horizon"):
        PushMpc(setup, PushTask(), period=0.03)


@pytest.mark.parametrize("seen", [np.zeros(10), np.zeros((1, 1, 11)), {"image": np.zeros((4, 4, 3))}, None])
def test_an_observation_without_a_state_is_refused(policy, seen):
    with pytest.raises(ParameterError, match="observation"):
        policy.predict(seen)


def test_plans_of_other_worlds_are_refused(policy, env):
    row, _ = env.reset(seed=0)
    with pytest.raises(ParameterError, match="state"):
        policy.predict(row, state=(None, None))
