# SPDX-License-Identifier: MIT
import dataclasses
from types import SimpleNamespace

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode
from pydrake.math import RigidTransform

from pinwm_drake.errors import ParameterError, SolverError
from pinwm_drake.systems.envs.env import TaskEnv
from pinwm_drake.systems.envs.options import EnvOptions
from pinwm_drake.systems.envs.registration import ENV_IDS
from pinwm_drake.systems.envs.vector import TaskVecEnv, TaskVectorEnv
from pinwm_drake.systems.envs.worlds import Worlds
from pinwm_drake.systems.scenario.load import load_setup
from pinwm_drake.systems.scenario.start import Place
from tests.systems.stations import FAR, REST, setup_of

W = 3


def vector(num_envs=W, **options):
    return TaskVectorEnv(setup_of(), num_envs, **options)


def actions(steps, worlds=W):
    return np.random.default_rng(5).uniform(-1, 1, (steps, worlds, 2)).astype(np.float32)


def part(observation, world):
    return {name: values[world] for name, values in observation.items()}


def equal(one, other):
    assert one.keys() == other.keys()
    for name, values in one.items():
        np.testing.assert_array_equal(values, other[name], err_msg=name)


@pytest.mark.parametrize("reward", ["paper", "shaped"])
def test_every_world_is_an_environment_of_its_own(reward):
    options = {"observation": "rgb_state", "frames": 2, "task": {"reward": reward}, "max_steps": 3}
    env = vector(**options)
    singles = [TaskEnv(setup_of(), "twin", **options) for _ in range(W)]
    seen, _ = env.reset(seed=7)
    for world, single in enumerate(singles):
        equal(part(seen, world), single.reset(seed=7 + world)[0])
    for action in actions(7):
        seen, rewards, terminated, truncated, infos = env.step(action)
        for world, single in enumerate(singles):
            own, reward_, *ends, info = single.step(action[world])
            assert (rewards[world], terminated[world], truncated[world]) == (reward_, *ends)
            for name in ("distance", "angle", "success", "step"):
                assert infos[name][world] == info[name]
            if any(ends):
                equal(infos["final_obs"][world], own)
                assert infos["_final_info"][world]
                own, _ = single.reset()
            equal(part(seen, world), own)


def test_spaces_and_mode_are_declared():
    env = vector(observation="rgb")
    assert env.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    seen, _ = env.reset(seed=0)
    assert env.observation_space.contains(seen)
    assert env.single_observation_space.contains(part(seen, 1))
    assert env.action_space.shape == (W, 2)
    made = gymnasium.make_vec(ENV_IDS["push"], num_envs=2, vectorization_mode="vector_entry_point", scene=setup_of())
    assert made.unwrapped.worlds.num_worlds == 2


def test_a_world_that_ends_does_not_touch_the_others():
    ended, going = vector(), vector()
    for env in (ended, going):
        env.reset(seed=1)
    # World 1 stands at the goal in one of the two.
    ended.worlds.run.set_world_state(np.array([1.0, 0.0, 0.0, 0.0, *REST.translation(), *np.zeros(6)]), FAR, 1)
    for step, action in enumerate(actions(3)):
        one, other = ended.step(action), going.step(action)
        np.testing.assert_array_equal(one[0][[0, 2]], other[0][[0, 2]])
        assert one[2].tolist() == [False, step == 0, False]


def test_the_same_seed_is_the_same_rollout():
    env = vector(max_steps=2)

    def rollout():
        return [env.reset(seed=3)[0], *(env.step(action)[0] for action in actions(5))]

    np.testing.assert_array_equal(rollout(), rollout())


def test_a_world_becomes_what_the_hook_gives():
    reset = []

    def fresh(world):
        reset.append(world)
        if world != 1:
            return None
        nominal = env.worlds.run.station.world.physics.parameters(1)
        return SimpleNamespace(
            parameters=lambda _: dataclasses.replace(nominal, friction=nominal.friction * 2.0),
            sh=setup_of().twin.surfels.sh * 0.0,
        )

    env = vector(observation="rgb", max_steps=2, domain=fresh)
    here = {"X_WO": REST, "p_WP": FAR + np.array([0.0, 0.0, 0.05])}
    seen, _ = env.reset(seed=0, options=here)
    assert reset == [0, 1, 2]
    model = env.worlds.run.station.world
    context = model.GetMyContextFromRoot(env.worlds.run._context)
    friction = model.GetParameters(context).friction.numpy()
    np.testing.assert_allclose(friction, np.array([[1.0], [2.0], [1.0]]) * friction[0])
    images = seen["image"]
    np.testing.assert_array_equal(images[0], images[2])
    assert (images[0] != images[1]).any()
    np.testing.assert_array_equal(images, env.worlds.run.images()[..., :3])
    env.reset(seed=0)
    assert reset == [0, 1, 2, 0, 1, 2]


def test_a_hook_with_other_colours_is_refused():
    def wrong(world):
        nominal = env.worlds.run.station.world.physics.parameters(1)
        return SimpleNamespace(parameters=lambda _: nominal, sh=setup_of().twin.surfels.sh[:-1])

    env = vector(observation="rgb", domain=wrong)
    with pytest.raises(ParameterError, match="sh: got"):
        env.reset()
    # Where no images are seen, colours are not looked at: to draw them takes longer than an action.
    env = vector(domain=wrong)
    env.reset()


@pytest.mark.parametrize(("latency", "part"), [(0.0, 0), (0.05, 3)])
def test_a_world_without_a_solution_is_truncated_and_the_others_go_on(monkeypatch, latency, part):
    env, free = vector(latency=(latency, latency)), vector(latency=(latency, latency))
    calls = 0
    for each in (env, free):
        each.reset(seed=2)
    physics, solve = env.worlds.run.station.world.physics, env.worlds.run.station.world.physics.advance
    bad = env.worlds.run.object_state[1, 4:6].copy()

    def fail(theta, state, p_WP, v_WP):
        nonlocal calls
        calls += 1
        failed = np.abs(state[:, 4:6] - bad).max(axis=1) < 1e-3
        if failed.any() and calls > part:
            worlds = tuple(np.flatnonzero(failed).tolist())
            raise SolverError(f"world {worlds[0]}, step 1: the contact LCP found no solution", worlds=worlds)
        return solve(theta, state, p_WP, v_WP)

    steps = actions(3)
    with monkeypatch.context() as patch:
        patch.setattr(physics, "advance", fail)
        seen, _, terminated, truncated, infos = env.step(steps[0])
    assert terminated.tolist() == [False, False, False]
    assert truncated.tolist() == [False, True, False]
    assert "no solution" in infos["final_info"]["failure"][1]
    np.testing.assert_array_equal(seen[[0, 2]], free.step(steps[0])[0][[0, 2]])
    for action in steps[1:]:
        np.testing.assert_array_equal(env.step(action)[0][[0, 2]], free.step(action)[0][[0, 2]])


def test_stable_baselines_sees_the_same():
    env, sb3 = vector(max_steps=2), TaskVecEnv(setup_of(), W, max_steps=2)
    sb3.seed(4)
    np.testing.assert_array_equal(sb3.reset(), env.reset(seed=4)[0])
    sums, lengths = np.zeros(W), np.zeros(W, int)
    for action in actions(4):
        seen, rewards, terminated, truncated, infos = env.step(action)
        again, rewards_, dones, own = sb3.step(action)
        sums += rewards
        lengths += 1
        np.testing.assert_array_equal(again, seen)
        np.testing.assert_allclose(rewards_, rewards, rtol=1e-6)
        np.testing.assert_array_equal(dones, terminated | truncated)
        for world in np.flatnonzero(dones):
            np.testing.assert_array_equal(own[world]["terminal_observation"], infos["final_obs"][world])
            assert own[world]["TimeLimit.truncated"] == truncated[world]
            assert own[world]["episode"]["r"] == pytest.approx(sums[world])
            assert own[world]["episode"]["l"] == lengths[world]
            sums[world], lengths[world] = 0.0, 0


def test_stable_baselines_takes_its_images():
    from stable_baselines3 import PPO

    env = TaskVecEnv(setup_of(), 2, observation="rgb", frames=2)
    model = PPO("MultiInputPolicy", env, n_steps=2, batch_size=4, n_epochs=1)
    model.learn(4)
    assert model.num_timesteps == 4


def test_options_of_stable_baselines():
    env = TaskVecEnv(setup_of(), 2)
    env.set_options([{"X_WO": REST, "p_WP": FAR}, {"X_WO": RigidTransform([0.1, 0.0, 0.025]), "p_WP": FAR}])
    env.reset()
    _, _, dones, infos = env.step(np.zeros((2, 2)))
    assert dones.tolist() == [True, False]
    assert infos[0]["is_success"]
    assert not infos[0]["TimeLimit.truncated"]
    assert env.get_attr("num_worlds") == [2, 2]
    with pytest.raises(ParameterError, match="indices"):
        env.set_attr("max_steps", 5, indices=[0])
    env.set_attr("max_steps", 5)
    assert env.worlds.max_steps == 5


def test_tolerances_are_those_that_were_asked_for():
    here = {"X_WO": RigidTransform([0.015, 0.0, 0.025]), "p_WP": FAR}
    for tolerance, success in ((0.01, False), (0.02, True)):
        env = vector(task={"tolerance": tolerance})
        env.reset(options=here)
        assert env.step(np.zeros((W, 2)))[2].tolist() == [success] * W


def test_no_world_is_refused():
    with pytest.raises(ParameterError, match="num_envs: got 0"):
        vector(0)


def test_seeds_are_one_or_one_for_each_world():
    env = vector()
    one = env.reset(seed=np.int64(3))[0]
    np.testing.assert_array_equal(env.reset(seed=[3, 4, 5])[0], one)
    with pytest.raises(ParameterError, match="seeds: got 2; allowed: 3"):
        env.reset(seed=[3, 4])


@pytest.mark.parametrize("most", [None, 50.0])
def test_a_press_beyond_the_limit_fails(most):
    task = load_setup("flip_cube").task.for_training()
    worlds = Worlds("flip_cube", "twin", 2, EnvOptions(time_step=1 / 480, task=task))
    worlds.reset()
    X_WO = RigidTransform([0.0, 0.0, 0.03])
    for world, height in enumerate((0.072, 0.25)):
        worlds.run.place(Place(X_WO, np.array([0.0, 0.0, height])), world)
    worlds.set_object_states(worlds.run.object_state.copy(), worlds.run.p_WP.copy())
    worlds.most_force = most
    out = worlds.advance(np.tile([0.0, 0.0, -0.5], (2, 1)))  # onto the top; and down to it from far above
    assert out.terminated.tolist() == [most is not None, False]
    assert not out.progress.success.any()
    assert abs(out.reward[1]) < 1.0
    if most is None:
        assert not out.failures
    else:
        assert "mean force over 50.0 N" in out.failures[0]
