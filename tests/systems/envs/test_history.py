# SPDX-License-Identifier: MIT
import warnings

import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from stable_baselines3.common.env_checker import check_env as check_env_of_sb3

from pinwm_drake.errors import ParameterError
from pinwm_drake.systems.envs.env import TaskEnv
from pinwm_drake.systems.envs.options import EnvOptions
from pinwm_drake.systems.envs.policy_scene import policy_spec, spec_environment
from pinwm_drake.systems.envs.vector import TaskVecEnv
from tests.systems.stations import action_setup, setup_of

W, LENGTH = 3, 2
ENDS = np.array([1, 3, 6])  # actions of the episodes of each world
ACTIONS = np.random.default_rng(5).uniform(-1, 1, (9, W, 2)).astype(np.float32)


def entry(seen, name):
    return seen[name] if isinstance(seen, dict) else seen


class Recording:
    """What a world showed without a history, and what it was asked for, in an episode."""

    def __init__(self, now):
        self.shown, self.asked = [now], []

    def add(self, action, now):
        self.asked.append(action / max(np.linalg.norm(action), 1.0))
        self.shown.append(now)

    def row(self):
        """The last of it and what was before."""
        parts = [self.shown[-1]]
        for k in range(1, LENGTH + 1):
            there = k < len(self.shown)
            parts += [self.shown[-1 - k], self.asked[-k]] if there else [self.shown[0], np.zeros(2)]
        return np.concatenate(parts)


@pytest.mark.parametrize(
    ("kind", "name"), [("state", "state"), ("rgb", "pusher"), ("rgb_state", "state"), ("rgb_state", "pusher")]
)
def test_rows_are_what_a_recording_says_across_resets_and_for_each_world(kind, name):
    plain, env = (TaskVecEnv(setup_of(), W, observation=kind, history=history) for history in (0, LENGTH))
    for each in (plain, env):
        each.worlds.max_steps = ENDS
        each.seed(4)
    now, seen = entry(plain.reset(), name), entry(env.reset(), name)
    records, ends = [Recording(now[world]) for world in range(W)], 0
    for actions in ACTIONS:
        for world, record in enumerate(records):
            np.testing.assert_allclose(seen[world], record.row(), atol=1e-6)
        now, _, ended, told = plain.step(actions)
        seen, *_, infos = env.step(actions)
        now, seen = entry(now, name), entry(seen, name)
        for world, record in enumerate(records):
            if ended[world]:
                record.add(actions[world], entry(told[world]["terminal_observation"], name))
                last = entry(infos[world]["terminal_observation"], name)
                np.testing.assert_allclose(last, record.row(), atol=1e-6)
                records[world], ends = Recording(now[world]), ends + 1
            else:
                record.add(actions[world], now[world])
    assert ends == sum(len(ACTIONS) // ENDS)


@pytest.mark.parametrize(
    ("observation", "engine"),
    [
        ("state", "point"),
        ("rgb", "twin"),
        *(pytest.param(*one, marks=pytest.mark.nightly) for one in (("state", "twin"), ("rgb", "point"))),
    ],
)
def test_an_environment_with_a_history_passes_both_checkers(engine, observation):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        env = TaskEnv(setup_of(), engine, observation=observation, frames=3, history=LENGTH)
        check_env(env, skip_render_check=True)
        check_env_of_sb3(env)


def test_an_action_late_or_not_is_told_as_it_was_asked_for():
    env = TaskEnv(setup_of(), "twin", history=1, latency=(0.1, 0.1))
    env.reset(seed=0)
    seen = env.step(np.array([0.6, -0.2], np.float32))[0]
    np.testing.assert_allclose(seen[-2:], [0.6, -0.2], atol=1e-6)
    np.testing.assert_allclose(seen[9:11], seen[11 + 9 : 11 + 11], atol=1e-4)  # it has not moved yet
    seen = env.step(np.array([np.nan, 1.0]))[0]
    np.testing.assert_array_equal(seen[-2:], [0.0, 0.0])


def test_worlds_that_are_put_into_a_state_have_no_past():
    env = TaskVecEnv(setup_of(), W, history=LENGTH)
    env.seed(0)
    env.reset()
    env.step(ACTIONS[0])
    env.worlds.set_object_states(env.worlds.run.object_state, env.worlds.run.p_WP)
    seen = env.worlds.observe()
    np.testing.assert_array_equal(seen, [Recording(row[:11]).row() for row in seen])


def test_a_policy_with_a_history_gets_it_in_its_environment():
    options = EnvOptions(frames=3, history=LENGTH, max_translation=0.02)
    spec = policy_spec(action_setup(setup_of(), image_size=32), options, "rgb")
    seen, _ = spec_environment(spec, setup_of(), "twin").reset(seed=0)
    assert seen["pusher"].shape == (2 + LENGTH * 4,)
    assert seen["image"].shape == (32, 32, 9)


@pytest.mark.parametrize("changes", [{"history": -1}, {"history": 2, "task": {"goal_range": (0.1, 0.1, 1.0)}}])
def test_a_history_that_makes_no_sense_is_refused(changes):
    with pytest.raises(ParameterError, match=f"history: got {changes['history']}"):
        TaskEnv(setup_of(), "twin", **changes)
