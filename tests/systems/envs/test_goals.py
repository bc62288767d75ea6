# SPDX-License-Identifier: MIT
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from pydrake.math import RigidTransform, RollPitchYaw
from stable_baselines3.common.env_checker import check_env as check_sb3

from pinwm_drake.errors import ParameterError
from pinwm_drake.learning.worlds import TowardGoal
from pinwm_drake.systems.envs.env import TaskEnv
from pinwm_drake.systems.envs.vector import TaskVecEnv

RANDOM = {"goal_range": (0.1, 0.1, np.pi)}
GOAL = np.array([0.08, -0.05, 1.1])


@pytest.mark.filterwarnings("ignore:.*WARN.*")
@pytest.mark.parametrize("observation", ["state", "rgb"])
def test_environments_of_drawn_goals_are_as_gymnasium_and_sb3_want_them(observation):
    env = TaskEnv("push_t", "twin", task=RANDOM, observation=observation, image_size=48)
    check_env(env, skip_render_check=True)
    check_sb3(env, warn=False)


def test_each_episode_has_a_goal_of_its_own_that_is_observed():
    env = TaskEnv("push_t", "twin", task=RANDOM)
    seen = [env.reset(seed=seed)[0]["goal"] for seed in (0, 1, 0)]
    np.testing.assert_array_equal(seen[0], seen[2])
    assert not np.allclose(seen[0], seen[1])
    np.testing.assert_allclose(env.worlds.goal[0], seen[2], atol=1e-6)
    given, _ = env.reset(seed=0, options={"goal": GOAL})
    np.testing.assert_allclose(given["goal"], GOAL, atol=1e-6)
    with pytest.raises(ParameterError, match="goal: got"):
        env.reset(options={"goal": GOAL[:2]})
    with pytest.raises(ParameterError, match="goal: got"):
        TaskEnv("push_t", "twin").reset(options={"goal": GOAL})


def test_an_object_at_its_goal_is_a_success():
    env = TaskEnv("push_t", "twin", task=RANDOM)
    x, y, yaw = GOAL
    height = env.reset(seed=0)[1] and env.run.object_state[0, 6]
    there = RigidTransform(RollPitchYaw(0, 0, yaw), [x + 0.01, y, height])
    env.reset(options={"X_WO": there, "p_WP": np.array([0.3, 0.3, 0.025]), "goal": GOAL})
    *_, info = env.step(np.zeros(2))
    assert info["success"]
    assert info["distance"] == pytest.approx(0.01, abs=1e-4)
    assert info["angle"] == pytest.approx(0.0, abs=1e-3)
    env.reset(options={"X_WO": there, "p_WP": np.array([0.3, 0.3, 0.025]), "goal": [0.0, 0.0, 0.0]})
    assert not env.step(np.zeros(2))[-1]["success"]


def test_a_push_seen_from_a_goal_does_not_depend_on_where_the_goal_is():
    """The same push of a scene that is moved with its goal: states agree, as far as the step's tolerance goes."""
    states = []
    for goal in (np.zeros(3), GOAL):
        env = TowardGoal(TaskVecEnv("push_t", 1, task=RANDOM), TaskEnv("push_t", "twin", task=RANDOM).task)
        X = RigidTransform(RollPitchYaw(0, 0, goal[2]), [*goal[:2], 0.0])
        env.seed(0)
        env.reset()
        height = env.venv.worlds.run.object_state[0, 6]
        place = X @ RigidTransform(RollPitchYaw(0, 0, 0.3), [0.05, 0.02, height])
        env.set_options({"X_WO": place, "p_WP": X @ np.array([-0.03, 0.02, 0.025]), "goal": goal})
        rows = [env.reset()]
        rows += [env.step(np.array([[1.0, 0.1]], np.float32))[0] for _ in range(12)]
        states.append(np.concatenate(rows))
    assert np.linalg.norm(states[0][-1, :2] - states[0][0, :2]) > 0.3  # it was pushed
    np.testing.assert_allclose(states[0], states[1], atol=2e-3)


def test_worlds_of_drawn_goals_go_on_as_they_were_kept():
    def make():
        env = TaskVecEnv("push_t", 3, task=RANDOM, max_steps=5)
        env.seed(2)
        return TowardGoal(env, env.worlds.task)

    env, actions = make(), np.random.default_rng(0).uniform(-1.0, 1.0, (12, 3, 2)).astype(np.float32)
    env.reset()
    for action in actions[:6]:
        env.step(action)
    kept = env.get_state()
    expected = [env.step(action)[0] for action in actions[6:]]
    again = make()
    again.reset()
    again.set_state(kept)
    np.testing.assert_array_equal(expected, [again.step(action)[0] for action in actions[6:]])
    assert {len(row) for row in again.venv.worlds.goal} == {3}
