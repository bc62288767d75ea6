# SPDX-License-Identifier: MIT
import math

import numpy as np
import pytest
import torch
from gymnasium import spaces
from pydrake.math import RotationMatrix
from stable_baselines3.common.vec_env import VecEnv

from pinwm_drake.learning import rounds
from pinwm_drake.learning.heading import AlongHeading, Heading
from pinwm_drake.learning.policy import Policy, make_actor
from pinwm_drake.learning.ppo import PpoOptions, train_ppo
from pinwm_drake.learning.rounds import StageRun
from pinwm_drake.learning.sac import SacOptions, train_sac
from pinwm_drake.tasks.flip import FlipTask
from pinwm_drake.tasks.push import PushTask
from pinwm_drake.tasks.waypoints import Waypoints
from tests.learning.toy_worlds import toy_spec

TASK = FlipTask(up=(0.0, 0.6, -0.8), side=(1.0, 0.2, 0.1))


def flip_spec(**changes):
    box = {"pusher_low": (-0.3, -0.3, 0.0), "pusher_high": (0.3, 0.3, 0.3)}
    return toy_spec("state", task=TASK, **box, **changes)


def scenes(number, seed=0):
    generator = np.random.default_rng(seed)
    q_WO = generator.normal(size=(number, 4))
    q_WO /= np.linalg.norm(q_WO, axis=1)[:, None]
    return np.column_stack([q_WO, generator.uniform(-0.3, 0.3, (number, 9))]), generator.uniform(-0.3, 0.3, (number, 3))


def turned(states, p_WP, yaw):
    """The scenes turned about the world's z."""
    R = RotationMatrix.MakeZRotation(yaw)
    w, z = np.cos(yaw / 2), np.sin(yaw / 2)
    a, b, c, d = states[:, :4].T
    q = np.column_stack([w * a - z * d, w * b - z * c, w * c + z * b, w * d + z * a])
    vectors = [states[:, k : k + 3] @ R.matrix().T for k in (4, 7, 10)]
    return np.column_stack([q, *vectors]), p_WP @ R.matrix().T


@pytest.mark.parametrize("history", [0, 2])
@pytest.mark.parametrize("head", ["levels", "tanh", "dither"])
def test_a_policy_does_the_same_at_any_yaw(head, history):
    torch.manual_seed(1)
    actor = make_actor(flip_spec(head=head, history=history))
    states, p_WP = scenes(40)
    past = [(*scenes(40, seed=1 + k), np.random.default_rng(k).uniform(-0.5, 0.5, (40, 3))) for k in range(history)]

    def seen(yaw):
        parts = [TASK.state(*turned(states, p_WP, yaw))]
        for state, pusher, action in past:
            parts += [TASK.state(*turned(state, pusher, yaw)), action @ RotationMatrix.MakeZRotation(yaw).matrix().T]
        return torch.from_numpy(np.concatenate(parts, axis=1, dtype=np.float32))

    with torch.no_grad():
        before, after = actor(seen(0.0)).numpy(), actor(seen(0.9)).numpy()
    wanted = before @ RotationMatrix.MakeZRotation(0.9).matrix().T
    # A wave turns by up to 60 rad for a unit of the state, whose rounding it makes larger.
    np.testing.assert_allclose(after, wanted, atol=1e-3 if head == "dither" else 2e-5)
    assert np.linalg.norm(before, axis=1).max() <= 1.0 + 1e-6
    assert np.abs(before[:, :2]).max() > 0.01


def test_along_the_heading_the_pusher_is_ahead_and_an_action_ahead_moves_it_away():
    states, p_WP = scenes(20)
    state, heading = torch.from_numpy(TASK.state(states, p_WP)), Heading(TASK)
    seen = heading.state(state)
    assert (seen[:, 15] > 0).all()
    assert seen[:, 16].abs().max() < 1e-5
    np.testing.assert_allclose(seen[:, 2::3], state[:, 2::3])
    np.testing.assert_allclose(seen.norm(dim=1), state.norm(dim=1), rtol=1e-5)
    ahead = heading.action(torch.tensor([[0.5, 0.0, 0.2]]).repeat(20, 1), state).numpy()
    away = p_WP - states[:, 4:7]
    level = away[:, :2] / np.linalg.norm(away[:, :2], axis=1)[:, None]
    np.testing.assert_allclose(ahead, np.column_stack([0.5 * level, np.full(20, 0.2)]), atol=1e-5)


def test_a_pusher_right_above_looks_along_x_and_other_tasks_have_no_heading():
    state = torch.zeros(1, 18)
    state[0, 17], state[0, 3] = 0.7, 0.5
    assert torch.equal(Heading(TASK).state(state), state)
    assert Heading(TASK).action(torch.tensor([[0.3, 0.1, 0.0]]), state)[0].tolist() == pytest.approx([0.3, 0.1, 0.0])
    other = torch.randn(3, 11)
    assert Heading(PushTask()).state(other) is other
    assert Heading(PushTask()).action(other, other) is other


def test_actions_are_told_along_the_heading_and_back():
    states, p_WP = scenes(20)
    state, action = torch.from_numpy(TASK.state(states, p_WP)), torch.rand(20, 3) / 2
    heading = Heading(TASK)
    np.testing.assert_allclose(heading.action(heading.along(action, state), state), action, atol=1e-6)
    assert Heading(PushTask()).along(action, state) is action


class Turntable(VecEnv):
    """Worlds in which the pusher is to get near an object that stands elsewhere in each episode."""

    def __init__(self, num_envs=8):
        super().__init__(num_envs, spaces.Box(-20.0, 20.0, (18,), np.float32), spaces.Box(-1.0, 1.0, (3,), np.float32))
        self._generators = [np.random.default_rng() for _ in range(num_envs)]
        self._away, self._steps = np.zeros((num_envs, 3)), np.zeros(num_envs, int)
        self.actions = []

    def seed(self, seed=None):
        self._generators = [np.random.default_rng(seed + world) for world in range(self.num_envs)]
        return [seed + world for world in range(self.num_envs)]

    def reset(self):
        for world in range(self.num_envs):
            self._begin(world)
        return self._see()

    def step_async(self, actions):
        self.actions.append(np.array(actions))

    def step_wait(self):
        before = np.linalg.norm(self._away, axis=1)
        self._away = self._away + 0.3 * self.actions[-1]
        after = np.linalg.norm(self._away, axis=1)
        self._steps += 1
        done = after < 0.3
        ended = done | (self._steps >= 10)
        seen, infos = self._see(), [{} for _ in ended]
        for world in np.flatnonzero(ended):
            info = {"distance": after[world], "angle": 0.0, "success": bool(done[world])}
            last = {"terminal_observation": seen[world].copy(), "TimeLimit.truncated": not done[world]}
            infos[world] = info | last
            self._begin(world)
        return self._see(), (before - after).astype(np.float32), ended, infos

    def get_state(self):
        from pinwm_drake.checkpoints import generator_state

        generators = np.stack([generator_state(one) for one in self._generators])
        return {"away": self._away.copy(), "steps": self._steps.copy(), "generators": generators}

    def set_state(self, arrays):
        from pinwm_drake.checkpoints import set_generator_state

        self._away, self._steps = arrays["away"].copy(), arrays["steps"].copy()
        for generator, state in zip(self._generators, arrays["generators"], strict=True):
            set_generator_state(generator, state)

    def _begin(self, world):
        yaw = self._generators[world].uniform(-math.pi, math.pi)
        self._away[world], self._steps[world] = [math.cos(yaw), math.sin(yaw), 0.3], 0

    def _see(self):
        seen = np.zeros((self.num_envs, 18), np.float32)
        seen[:, 15:18] = self._away
        return seen

    def close(self):
        pass

    def get_attr(self, name, indices=None):
        raise AttributeError(name)

    def set_attr(self, name, value, indices=None):
        raise AttributeError(name)

    def env_method(self, name, *args, indices=None, **kwargs):
        raise AttributeError(name)

    def env_is_wrapped(self, wrapper_class, indices=None):
        return [False] * self.num_envs


def test_worlds_get_the_actions_that_the_policy_gives():
    torch.manual_seed(0)
    spec = flip_spec(head="tanh")
    actor, env = make_actor(spec), Turntable()
    env.seed(3)
    along = AlongHeading(env, TASK)
    state = torch.from_numpy(along.reset())
    with torch.no_grad():
        own = actor.head(actor.latent(state)).tanh().numpy()
        wanted = actor(state).numpy()
    along.step(own)
    np.testing.assert_allclose(env.actions[-1], wanted, atol=1e-6)


class Killed(Exception):
    pass


def ppo(env, folder, **changes):
    options = PpoOptions(steps=1024, round_steps=512, n_steps=16, batch_size=64, n_epochs=2, episodes=8)
    return train_ppo(env, flip_spec(), options, StageRun(folder, "teacher", **changes))


def sac(env, folder, **changes):
    options = SacOptions(steps=768, round_steps=384, learning_starts=64, batch_size=32, buffer_size=2000, episodes=8)
    return train_sac(env, flip_spec(head="dither"), options, StageRun(folder, "teacher", **changes))


@pytest.mark.parametrize("train", [ppo, pytest.param(sac, marks=pytest.mark.nightly)])
def test_a_training_that_was_killed_within_a_round_goes_on_with_the_same_result(tmp_path, monkeypatch, train):
    monkeypatch.setattr(rounds, "_PERIOD", 0.0)
    whole, told = train(Turntable(), tmp_path / "a"), []

    def kill(step):
        told.append(step)
        if len(told) == 3:
            raise Killed

    with pytest.raises(Killed):
        train(Turntable(), tmp_path / "b", report=kill)
    assert (tmp_path / "b" / rounds.ROUND_FILE).exists()
    again = train(Turntable(), tmp_path / "b", resume=True)
    for name, values in whole.actor.state_dict().items():
        assert torch.equal(values, again.actor.state_dict()[name])


def test_what_is_learned_at_some_yaws_is_known_at_all(tmp_path):
    policy = ppo(Turntable(), tmp_path)
    assert isinstance(policy, Policy)
    states, p_WP = scenes(30)
    state = torch.from_numpy(TASK.state(states, p_WP))
    turn = torch.from_numpy(TASK.state(*turned(states, p_WP, 2.0)))
    with torch.no_grad():
        one, other = policy.actor(state).numpy(), policy.actor(turn).numpy()
    np.testing.assert_allclose(other, one @ RotationMatrix.MakeZRotation(2.0).matrix().T, atol=2e-5)


def test_a_policy_begins_with_what_it_is_shown(tmp_path):
    along = torch.tensor([[-0.5, 0.2, 0.1]])
    options = PpoOptions(steps=128, round_steps=128, n_steps=16, batch_size=64, episodes=8, learning_rate=1e-9)

    def shown(number, seed):
        states, p_WP = scenes(number, seed)
        state = torch.from_numpy(TASK.state(states, p_WP))
        action = Heading(TASK).action(along.repeat(number, 1), state).numpy()
        return Waypoints(states, p_WP, action), state

    known, (other, state) = shown(250, 1)[0], shown(100, 2)
    errors = []
    for k, one in enumerate((known, known, Waypoints(), None)):
        policy = train_ppo(Turntable(), flip_spec(), options, StageRun(tmp_path / str(k), "teacher"), shown=one)
        errors.append(np.abs(policy.predict(state.numpy())[0] - other.action).max())
    assert errors[0] < 0.1
    assert errors[1] == errors[0]
    assert errors[2] == errors[3] > 0.3
