# SPDX-License-Identifier: MIT
from types import SimpleNamespace

import numpy as np
import pytest

from pinwm_drake.errors import ParameterError, SolverError
from pinwm_drake.systems.envs.delay import Delay
from pinwm_drake.systems.envs.env import TaskEnv
from pinwm_drake.systems.envs.station_run import StationRun
from pinwm_drake.systems.envs.vector import TaskVecEnv
from pinwm_drake.tasks.push import PushTask
from tests.systems.stations import action_setup

ACTIONS = np.array([[1.0, 0.0], [0.0, 0.5], [-1.0, 0.0], [0.6, -0.8], [0.0, 0.0], [0.0, 0.0], [0.0, 0.0]])


def delayed(latency, parts=1, world=0):
    delay = Delay((latency, latency), 0.1, 1, PushTask(), parts)
    delay.begin(world, np.random.default_rng(0))
    return np.stack([delay(action[None])[:, 0] for action in ACTIONS])


@pytest.mark.parametrize("parts", [1, 4])
@pytest.mark.parametrize("latency", [0.03, 0.1, 0.15, 0.2, 0.249])
def test_what_takes_effect_is_the_mean_of_what_was_asked_for_so_much_before(latency, parts):
    # The velocity that is asked for, at 10,000 samples a second.
    fine = np.repeat(ACTIONS, 1000, axis=0)
    late = np.concatenate([np.zeros((round(latency * 10_000), 2)), fine])[: len(fine)]
    mean = late.reshape(len(ACTIONS), parts, 1000 // parts, 2).mean(2)
    np.testing.assert_allclose(delayed(latency, parts), mean, atol=1e-12)


@pytest.mark.parametrize(("latency", "lag"), [(0.0, 0.04), (0.05, 0.08), (0.1, 0.01)])
def test_with_a_lag_the_velocity_follows_what_is_due(latency, lag):
    delay = Delay((latency, latency), 0.1, 1, PushTask(), 4, (lag, lag))
    delay.begin(0, np.random.default_rng(0))
    found = np.stack([delay(action[None])[:, 0] for action in ACTIONS])
    # The velocity that is due, and its lag in 10,000 short steps a second.
    due = np.repeat(np.broadcast_to(delayed(latency, 4), (len(ACTIONS), 4, 2)).reshape(-1, 2), 250, axis=0)
    velocities = [np.zeros(2)]
    for wanted in due:
        velocities.append(wanted + (velocities[-1] - wanted) * np.exp(-1e-4 / lag))
    mean = 0.5 * (np.array(velocities[:-1]) + velocities[1:])
    np.testing.assert_allclose(found, mean.reshape(len(ACTIONS), 4, 250, 2).mean(2), atol=1e-4)


def test_with_a_largest_acceleration_the_velocity_comes_evenly_nearer_to_what_is_due():
    delay = Delay((0.0, 0.0), 0.1, 1, PushTask(), 4, acceleration=40.0, max_translation=0.5)
    delay.begin(0, np.random.default_rng(0))
    found = np.stack([delay(action[None])[:, 0] for action in ACTIONS])
    # 40 m/s^2 for 0.1 s are 0.8 of the 5 m/s of the longest action.
    velocity, velocities = np.zeros(2), [np.zeros(2)]
    for wanted in np.repeat(ACTIONS, 4000, axis=0):  # 4,000 short steps a horizon
        change = wanted - velocity
        velocity = velocity + change / max(np.linalg.norm(change) / (0.8 / 4000), 1.0)
        velocities.append(velocity)
    mean = 0.5 * (np.array(velocities[:-1]) + velocities[1:])
    np.testing.assert_allclose(found, mean.reshape(len(ACTIONS), 4, 1000, 2).mean(2), atol=1e-3)
    assert abs(np.diff(np.concatenate([[np.zeros(2)], found.reshape(-1, 2)]), axis=0)).max() <= 0.2 + 1e-12
    with pytest.raises(ParameterError, match="one of the two"):
        Delay((0.0, 0.0), 0.1, 1, PushTask(), 4, (0.0, 0.1), 40.0, 0.5)


def test_a_pusher_that_lags_goes_on_from_actions_that_were_asked_for_before():
    delay = Delay((0.0, 0.0), 0.1, 1, PushTask(), 2, (0.05, 0.05))
    delay.begin(0, np.random.default_rng(0))
    assert delay.depth == 1
    delay.recall(0, np.array([[1.0, 0.0]]))
    moved = delay(np.zeros((1, 2)))[:, 0, 0]
    assert 1.0 > moved[0] > moved[1] > 0.0


def test_without_a_latency_actions_stay_as_they_are():
    assert np.array_equal(delayed(0.0)[:, 0], ACTIONS)


def test_an_action_that_is_too_long_is_shortened_before_it_is_mixed_with_others():
    delay = Delay((0.05, 0.05), 0.1, 1, PushTask())
    delay.begin(0, np.random.default_rng(0))
    np.testing.assert_allclose(delay(np.array([[1.0, 1.0]]))[0], [[0.5**1.5, 0.5**1.5]])


def test_each_world_has_a_latency_of_its_own_which_an_episode_draws():
    delay, generator = Delay((0.0, 0.15), 0.1, 200, PushTask()), np.random.default_rng(1)
    for world in range(200):
        delay.begin(world, generator)
    moved = delay(np.tile([1.0, 0.0], (200, 1)))[0, :, 0]
    assert np.mean(moved == 0.0) == pytest.approx(1 / 3, abs=0.1)  # 100 to 150 ms
    assert 0.0 <= moved.min() < moved.max() <= 1.0
    delay.begin(3, generator)
    assert delay(np.zeros((200, 2)))[0, 3, 0] == 0.0  # The action before was of another episode.


def test_actions_that_were_asked_for_before_an_episode_take_effect_in_it():
    delay = Delay((0.15, 0.15), 0.1, 2, PushTask(), 2)
    for world in range(2):
        delay.begin(world, np.random.default_rng(0))
    assert delay.depth == 2
    delay.recall(1, np.array([[0.5, 0.0], [0.0, 0.25]]))
    moved = delay(np.zeros((2, 2)))
    assert not moved[:, 0].any()
    np.testing.assert_allclose(moved[:, 1], [[0.0, 0.25], [0.5, 0.0]], atol=1e-12)


@pytest.mark.parametrize("latency", [(-0.1, 0.0), (0.2, 0.1), (0.0, float("nan")), (0.0, float("inf"))])
def test_a_latency_that_makes_no_sense_is_refused(latency):
    with pytest.raises(ParameterError, match="latency"):
        Delay(latency, 0.1, 1, PushTask())


def test_the_pusher_of_an_environment_is_late():
    prompt, late = (TaskEnv("push_t", "twin", latency=(seconds, seconds)) for seconds in (0.0, 0.1))
    for env in (prompt, late):
        env.reset(seed=4)
    states = {env: [env.step(np.array(action, np.float32))[0] for action in ACTIONS] for env in (prompt, late)}
    pushers = {env: np.array(seen)[:, 9:11] for env, seen in states.items()}
    np.testing.assert_allclose(pushers[late][1:], pushers[prompt][:-1], atol=1e-6)


def test_a_pusher_that_is_half_an_action_late_turns_round_in_the_middle_of_one():
    late = TaskEnv("push_t", "twin", latency=(0.05, 0.05))
    late.reset(seed=4)
    begun = late.run.p_WP[0, 0]
    back = [late.step(np.array([x, 0.0], np.float32)) and late.run.p_WP[0, 0] - begun for x in (-1.0, 1.0, 0.0)]
    longest = late.run.max_translation
    np.testing.assert_allclose(back, [-0.5 * longest, -0.5 * longest, 0.0], atol=1e-9)


def test_worlds_that_are_late_go_on_as_they_were_kept():
    options = {"latency": (0.0, 0.15), "time_step": 1 / 120}  # six parts of an action, whose ends are not exact
    env = TaskVecEnv("push_t", 3, **options)
    env.seed(2)
    env.reset()
    generator = np.random.default_rng(0)
    actions = generator.uniform(-1.0, 1.0, (12, 3, 2)).astype(np.float32)
    for action in actions[:6]:
        env.step(action)
    kept = env.get_state()
    expected = [env.step(action)[0] for action in actions[6:]]
    again = TaskVecEnv("push_t", 3, **options)
    again.reset()
    again.set_state(kept)
    np.testing.assert_array_equal(expected, [again.step(action)[0] for action in actions[6:]])


@pytest.mark.parametrize("engine", ["twin", "point"])
def test_an_action_that_fails_in_its_second_half_is_not_kept_by_a_twin_and_counts_for_a_plant(engine, monkeypatch):
    run = StationRun(action_setup("push_t", time_step=1 / 120), engine, None, parts=2)
    steps, simulator = [], run._simulator

    def fails_once(t):
        steps.append(t)
        if len(steps) == 4:
            raise SolverError("no solution")
        simulator.AdvanceTo(t)

    monkeypatch.setattr(run, "_simulator", SimpleNamespace(AdvanceTo=fails_once, Initialize=simulator.Initialize))
    forward = np.array([[0.0, -0.5]])
    run.advance(forward)
    before = run.p_WP.copy()
    with pytest.raises(SolverError):
        run.advance(forward)
    halfway = run.p_WP.copy()
    run.retry()
    run.advance(forward)
    # A plant cannot be put back: its next action ends where one without a failure would have ended.
    kept, ends = (0.5, [0.25, 0.3]) if engine == "point" else (0.0, [0.15, 0.2])
    np.testing.assert_allclose(steps[4:], ends)
    whole = 0.5 * run.max_translation
    assert np.linalg.norm(halfway - before) == pytest.approx(kept * whole, abs=1e-6)
