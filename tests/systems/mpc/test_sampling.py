# SPDX-License-Identifier: MIT
import dataclasses

import numpy as np
import pytest

from pinwm_drake.errors import ParameterError
from pinwm_drake.systems.envs.env import TaskEnv
from pinwm_drake.systems.envs.options import EnvOptions
from pinwm_drake.systems.mpc.sampling import ActionPlan, SamplingMpc, SamplingOptions
from pinwm_drake.systems.scenario.load import load_setup

COARSE = EnvOptions(time_step=1 / 480)


@pytest.fixture(scope="module")
def cube():
    setup = load_setup("flip_cube")
    return dataclasses.replace(setup, twin=dataclasses.replace(setup.twin, time_step=1 / 480))


def test_a_cube_is_flipped_in_the_twin(cube):
    env = TaskEnv(cube, "twin", COARSE)
    policy = SamplingMpc(cube, env.task, options=SamplingOptions(samples=64))
    observation, info = env.reset(seed=0)
    assert info["angle"] == pytest.approx(np.pi / 2)
    plans = None
    for _ in range(env.max_steps):
        action, plans = policy.predict(observation, plans)
        observation, _, terminated, truncated, info = env.step(action)
        if terminated or truncated:
            break
    assert info["success"]
    assert info["angle"] < 0.2


def test_a_plan_follows_from_what_is_seen_whatever_was_planned_before(cube):
    policy = SamplingMpc(cube, options=SamplingOptions(samples=16, horizon=4, first_iterations=1))
    env = TaskEnv(cube, "twin", COARSE)
    one, two = (np.asarray(env.reset(seed=seed)[0]) for seed in (3, 4))
    (first, _), (both, plans) = policy.predict(one), policy.predict(np.stack([two, one]))
    assert np.array_equal(first, both[1])
    assert not np.array_equal(both[0], both[1])
    # An episode begins anew, while the plan of another world is gone on with.
    ahead, _ = policy.predict(two, [plans[0]])
    later, _ = policy.predict(np.stack([two, one]), plans, np.array([False, True]))
    assert np.array_equal(later, [ahead, first])


def test_a_plan_keeps_what_it_promises(cube):
    options = SamplingOptions(samples=16, horizon=5, first_iterations=2)
    planner, env = SamplingMpc(cube, options=options), TaskEnv(cube, "twin", dataclasses.replace(COARSE, max_steps=5))
    observation, _ = env.reset(seed=1)
    state, p_WP = env.task.object_state(np.asarray(observation)[None])
    plan = planner.plan(state[0], p_WP[0])
    assert plan.actions.shape == (5, 3)
    assert np.abs(plan.actions).max() <= 1.0
    rewards, before = [], planner.task.measure(state, p_WP)
    for action in plan.actions:
        env.step(action)
        after = env.worlds.progress
        rewards.append(float(planner.task.rewards(before, after)[0]))
        before = after
    effort = options.effort * (plan.actions**2).sum()
    assert sum(rewards) - effort == pytest.approx(plan.value, abs=1e-3)


def test_half_of_the_first_sequences_of_a_plan_are_strokes_from_the_pusher_to_the_object(cube, monkeypatch):
    planner = SamplingMpc(cube, options=SamplingOptions(samples=400, horizon=4, first_iterations=1))
    tried = []

    def values(actions, object_state, p_WP):
        tried.append(actions)
        return np.zeros(len(actions)), np.zeros(len(actions), bool)

    monkeypatch.setattr(planner, "_values", values)
    state = np.array([1, 0, 0, 0, 0, 0, 0.03, *np.zeros(6)], float)
    for away, along in (
        ([0.1, 0, 0.03], [1.0, 0.0]),
        ([0, 0.1, 0.03], [0.0, 1.0]),
        ([-0.06, -0.06, 0.03], [-0.71, -0.71]),
    ):
        planner.plan(state, np.array(away))
        first, strokes = np.split(tried.pop(), 2)
        across = strokes[..., :2] @ np.array([-along[1], along[0]])
        assert np.abs(across).max() < 0.01
        assert (strokes[:, 1, :2] @ along).mean() < -0.3
        assert np.abs(first.mean((0, 1))).max() < 0.1


@pytest.mark.parametrize("bears", [True, False])
def test_the_middle_of_good_plans_is_taken_where_it_succeeds_and_the_best_one_otherwise(cube, monkeypatch, bears):
    options = SamplingOptions(samples=64, horizon=2, first_iterations=4, elites=8, kept=0, cousins=1)
    planner = SamplingMpc(cube, options=options)
    tried, worth = [], []

    def values(actions, object_state, p_WP):
        tried.append(actions.copy())
        worth.append(-((actions - 0.3) ** 2).sum((1, 2)))
        successes = np.ones(len(actions), bool)
        successes[-1] = bears
        return worth[-1], successes

    monkeypatch.setattr(planner, "_values", values)
    plan = planner.plan(np.full(13, np.nan), np.full(3, np.nan))
    if bears:
        np.testing.assert_array_equal(plan.actions, tried[-1][-1])
        good = tried[-2][np.argsort(-worth[-2])[:8]].mean(0)
        assert np.abs(plan.actions - good).max() < 0.1  # but for the momentum
        assert np.abs(plan.actions - 0.3).max() < 0.3
    else:
        every, values_of = np.concatenate(tried), np.concatenate(worth)
        np.testing.assert_array_equal(plan.actions, every[values_of.argmax()])


def test_of_plans_that_succeed_the_one_that_does_in_all_cousins_is_taken(cube, monkeypatch):
    planner = SamplingMpc(cube, options=SamplingOptions(samples=128, horizon=2, elites=8, cousins=8))
    tried = []

    def values(actions, object_state, p_WP):
        bold = actions[:, 0, 0] > 0.0  # as good as can be in the first cousin, and bad in all others
        tried.append(actions.copy())
        first = np.arange(len(actions)) % 8 == 0
        successes = ~bold | first if len(tried) > 1 else bold
        return np.where(bold, np.where(first | (len(tried) == 1), 2.0, -2.0), 1.0), successes

    monkeypatch.setattr(planner, "_values", values)
    plan = planner.plan(np.full(13, np.nan), np.full(3, np.nan))
    assert plan.success
    assert plan.value == 1.0
    assert plan.actions[0, 0] <= 0.0
    assert len(tried) == 4  # one round that found a success, and three in all cousins
    np.testing.assert_array_equal(tried[1][:8], np.tile(tried[1][0], (8, 1, 1)))
    assert tried[1][0, 0, 0] > 0.0  # what succeeded at first is tried again


def test_worlds_that_are_left_over_do_not_count(cube, monkeypatch):
    planner = SamplingMpc(cube, options=SamplingOptions(samples=21, horizon=2, elites=2, kept=1, cousins=4))
    sizes = []

    def values(actions, object_state, p_WP):
        sizes.append(len(actions))
        worth = np.where(np.arange(21) < 20, actions[:, 0, 0], 1e3)
        return worth, np.ones(21, bool)

    monkeypatch.setattr(planner, "_values", values)
    plan = planner.plan(np.full(13, np.nan), np.full(3, np.nan), ActionPlan(np.zeros((2, 3)), 0.0, True))
    assert set(sizes) == {21}
    assert plan.value == pytest.approx(plan.actions[0, 0])


def test_the_worlds_of_a_planner_are_the_twin_and_its_cousins(cube):
    planner = SamplingMpc(cube, options=SamplingOptions(samples=16, elites=2, kept=1, cousins=4))
    state = planner.worlds.run.get_state()
    (theta,) = [one for name, one in state.items() if name.startswith("numeric.")][:1]
    rows = theta.reshape(16, -1)
    np.testing.assert_array_equal(rows, np.tile(rows[:4], (4, 1)))
    twin = SamplingMpc(cube, options=SamplingOptions(samples=16, elites=2, kept=1, cousins=1)).worlds.run.get_state()
    alone = next(one for name, one in twin.items() if name.startswith("numeric."))
    np.testing.assert_array_equal(rows[0], alone.reshape(16, -1)[0])
    assert len(np.unique(rows[:4], axis=0)) == 4


def test_more_rounds_find_no_worse_plans(cube):
    env = TaskEnv(cube, "twin", COARSE)
    state, p_WP = env.task.object_state(np.asarray(env.reset(seed=2)[0])[None])
    few, many = (
        SamplingMpc(cube, options=SamplingOptions(samples=16, first_iterations=rounds, cousins=1))
        .plan(state[0], p_WP[0])
        .value
        for rounds in (1, 6)
    )
    assert many >= few


def test_a_state_that_is_no_number_moves_nothing_and_a_wrong_one_is_refused(cube):
    policy = SamplingMpc(cube, options=SamplingOptions(samples=4, elites=2, kept=1, horizon=2))
    action, plans = policy.predict(np.full(18, np.nan))
    assert action.tolist() == [0.0, 0.0, 0.0]
    assert plans == (None,)
    with pytest.raises(ParameterError, match="18 numbers"):
        policy.predict({"image": np.zeros(3)})


@pytest.mark.parametrize(
    "wrong", [{"samples": 1}, {"elites": 300}, {"cousins": 0}, {"kept": 9}, {"spread": 0.0}, {"correlation": 1.0}]
)
def test_options_out_of_range_are_refused(wrong):
    with pytest.raises(ParameterError, match=next(iter(wrong))):
        SamplingOptions(**wrong)
