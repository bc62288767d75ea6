# SPDX-License-Identifier: MIT
import subprocess
import sys
import warnings
from itertools import product
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from pydrake.math import RigidTransform, RollPitchYaw
from stable_baselines3.common.env_checker import check_env as check_env_of_sb3

from pinwm_drake.errors import InputError, ParameterError, SolverError
from pinwm_drake.systems.envs.env import TaskEnv
from pinwm_drake.systems.envs.registration import ENV_IDS
from pinwm_drake.systems.scenario.schema import ENGINES
from pinwm_drake.systems.scenario.start import Place
from tests.systems.stations import FAR, REST, TURNED, setup_of

SLOW_NIGHTLY = [pytest.param(name, marks=pytest.mark.nightly) if name == "hydroelastic" else name for name in ENGINES]

ROOT = Path(__file__).resolve().parents[3]
NOWHERE = np.zeros(2)


def environment(engine="twin", **options):
    return TaskEnv(setup_of(), engine, **options)


@pytest.mark.parametrize(
    ("observation", "engine"),
    [
        pytest.param(*one, marks=() if one in (("state", "point"), ("rgb", "twin")) else pytest.mark.nightly)
        for one in product(("state", "rgb"), ENGINES)
    ],
)
def test_it_passes_both_checkers(engine, observation):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        env = gymnasium.make(
            ENV_IDS["push"],
            scene=setup_of(),
            engine=engine,
            observation=observation,
            frames=2,
            task={"reward": "shaped"},
            render_mode="rgb_array",
            disable_env_checker=True,
        ).unwrapped
        check_env(env, skip_render_check=engine != "twin")
        check_env_of_sb3(env)


@pytest.mark.parametrize("engine", SLOW_NIGHTLY)
def test_the_same_seed_is_the_same_episode(engine):
    env, actions = environment(engine), np.random.default_rng(0).uniform(-1, 1, (3, 2))

    def episode(env, seed):
        first, _ = env.reset(seed=seed)
        return [first, *(env.step(action)[0] for action in actions)]

    once, again, other = episode(env, 3), episode(env, 3), episode(env, 4)
    np.testing.assert_array_equal(once, again)
    np.testing.assert_array_equal(once, episode(environment(engine), 3))
    assert not np.array_equal(once[0], other[0])


@pytest.mark.parametrize("engine", ENGINES)
def test_an_action_is_a_translation_in_a_horizon(engine):
    env = environment(engine, max_translation=0.02)
    env.reset(seed=0, options={"X_WO": REST, "p_WP": FAR})
    expected = FAR.copy()
    for action, d in (((1, 0), (0.02, 0)), ((0.5, -0.25), (0.01, -0.005)), ((-1, 1), (-0.02 / 2**0.5, 0.02 / 2**0.5))):
        env.step(np.array(action, float))
        expected[:2] += d
        np.testing.assert_allclose(env.run.p_WP, [expected], atol=2e-5)
    env.step(np.array([np.nan, 1.0]))
    np.testing.assert_allclose(env.run.p_WP, [expected], atol=2e-5)


@pytest.mark.parametrize("engine", ENGINES)
def test_the_goal_reached_terminates(engine):
    env = environment(engine)
    _, info = env.reset(options={"place": Place(REST, FAR)})
    assert (info["step"], info["engine"]) == (0, engine)
    _, reward, terminated, truncated, info = env.step(NOWHERE)
    assert (terminated, truncated, info["success"], info["step"]) == (True, False, True, 1)
    assert reward == pytest.approx(-info["distance"] - info["angle"])


def test_another_goal():
    env = environment(task={"goal": (0.03, -0.02, 0.6)})
    env.reset(options={"X_WO": TURNED, "p_WP": FAR})
    assert env.step(NOWHERE)[2]


def test_tolerances_are_those_that_were_asked_for():
    here = {"X_WO": RigidTransform(RollPitchYaw(0.0, 0.0, 0.15), [0.015, 0.0, 0.025]), "p_WP": FAR}
    for options, success in (
        ({}, True),
        ({"tolerance": 0.01}, False),
        ({"turn_tolerance": 0.1}, False),
        ({"tolerance": 0.016, "turn_tolerance": 0.16}, True),
    ):
        env = environment(task=options)
        env.reset(options=here)
        assert env.step(NOWHERE)[2] == success, options


def test_the_time_limit_truncates():
    env = environment(max_steps=3)
    env.reset(seed=1, options={"X_WO": RigidTransform([0.1, 0.0, 0.025])})
    ends = [env.step(NOWHERE)[2:4] for _ in range(3)]
    assert ends == [(False, False), (False, False), (False, True)]


def test_success_in_the_last_step_is_no_truncation():
    env = environment(max_steps=1)
    env.reset(options={"X_WO": REST, "p_WP": FAR})
    assert env.step(NOWHERE)[2:4] == (True, False)


def test_a_physics_without_a_solution_truncates(monkeypatch):
    env = environment(observation="rgb_state")
    env.reset(seed=1)
    seen = env.step(NOWHERE)[0]

    def fail(*_):
        raise SolverError("world 0, step 3: the contact LCP found no solution", worlds=(0,))

    with monkeypatch.context() as patch:
        patch.setattr(env.run.station.world.physics, "advance", fail)
        after, _, terminated, truncated, info = env.step(np.array([1.0, 0.0]))
    assert (terminated, truncated) == (False, True)
    assert "no solution" in info["failure"]
    for name, values in seen.items():
        np.testing.assert_array_equal(after[name], values)
    env.reset(seed=1)
    np.testing.assert_array_equal(env.step(NOWHERE)[0]["state"], seen["state"])


def test_the_image_is_the_ports_without_alpha():
    env = environment(observation="rgb")
    image = env.reset(seed=2)[0]["image"]
    full = env.run.images()[0]
    np.testing.assert_array_equal(image, full[..., :3])
    assert (image[full[..., 3] == 0] == 255).all()
    assert (image < 255).any()


def test_the_picture_shows_goal_and_pusher():
    env = environment(render_mode="rgb_array")
    env.reset(options={"X_WO": RigidTransform([0.1, 0.1, 0.025]), "p_WP": [-0.1, 0.0, 0.05]})
    before = env.render()
    assert before.shape == (4 * 80, 4 * 96, 3)
    for _ in range(3):
        env.step(np.array([0.0, -1.0]))
    # Nothing but the pusher has moved, in the left half; the block's colours differ by its settling by 10 nm.
    changed = (np.abs(before.astype(int) - env.render()) > 30).any(axis=2)
    assert changed.any()
    assert not changed[:, 2 * 96 :].any()
    assert environment().render() is None


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"engine": "lcm"}, "engine: got 'lcm'"),
        ({"observation": "depth"}, "state, rgb, rgb_state"),
        ({"task": {"reward": "sparse"}}, "paper, shaped"),
        ({"task": {"speed": 1.0}}, "task.speed: got an unknown key; allowed: goal, q_WO"),
        ({"task": {"goal": [0.0, 0.0]}}, r"task.goal: got \[0.0, 0.0\]; allowed: 3 numbers"),
        ({"task": {"name": "juggle"}}, "task: got 'juggle'; allowed: a mapping whose name is one of .*push"),
        ({"frame": 2}, "options: got 'frame'; allowed: observation, frames, task"),
        ({"max_steps": 0}, "max_steps: got 0"),
        ({"task": {"tolerance": 0.0}}, "tolerance: got 0.0"),
        ({"task": {"turn_tolerance": -0.1}}, "turn_tolerance: got -0.1"),
        ({"max_translation": 0.06}, "at most 0.05 m"),
        ({"time_step": 0.03}, "whole multiple"),
        ({"render_mode": "human"}, "rgb_array"),
    ],
)
def test_options_that_cannot_be_are_refused(options, words):
    with pytest.raises(ParameterError, match=words):
        environment(**options)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"yaw": 1.0}, "options: got 'yaw'; allowed: place, X_WO, p_WP"),
        ({"X_WO": np.eye(4)}, "X_WO: got a ndarray; allowed: a RigidTransform"),
        ({"p_WP": [0.0, 0.0]}, "p_WP: got"),
    ],
)
def test_options_of_a_reset_that_cannot_be_are_refused(options, words):
    with pytest.raises(ParameterError, match=words):
        environment().reset(options=options)


def test_shipped_scenarios_are_known_by_name():
    assert TaskEnv("push_cube").setup.scenario.object == "cube"
    with pytest.raises(InputError, match=r"push_tea.*push_cube"):
        TaskEnv("push_tea")


def test_what_knows_the_name_loads_nothing_heavy():
    code = (
        "import gymnasium, sys, pinwm_drake.systems.envs.registration; print(gymnasium.spec('pinwm/Push-v0').id, "
        "[name for name in ('torch', 'pydrake', 'numba', 'stable_baselines3') if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "pinwm/Push-v0 []"


def test_gymnasium_imports_it_when_told_where():
    env = gymnasium.make(f"pinwm_drake.systems.envs.registration:{ENV_IDS['push']}", scene=setup_of())
    assert isinstance(env.unwrapped, TaskEnv)
