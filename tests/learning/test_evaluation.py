# SPDX-License-Identifier: MIT
import math

import numpy as np
import pytest
from stable_baselines3.common.vec_env import DummyVecEnv

from pinwm_drake.errors import ParameterError
from pinwm_drake.learning.evaluation import EpisodeResult, Evaluation, evaluate, run_episode
from pinwm_drake.learning.world_evaluation import evaluate_worlds
from tests.learning.ramps import Down, Drawn, Ramp


def start_of(seed: int) -> int:
    return int(Ramp().reset(seed=seed)[0][0])


@pytest.mark.parametrize("seed", range(6))
def test_an_episode_is_counted(seed):
    seen, policy, start = [], Down(), start_of(seed)
    result = run_episode(Ramp(), policy, seed, watch=lambda observation: seen.append(float(observation[0])))
    steps = min(start, 6)
    assert seen == list(range(start, start - steps - 1, -1))
    assert (result.seed, result.steps, result.success) == (seed, steps, start <= 6)
    assert (result.start_distance, result.distance) == (start, start - steps)
    assert result.outcome == ("success" if start <= 6 else "time limit")
    assert policy.begun == 1


def test_a_failure_is_kept():
    seed = next(seed for seed in range(100) if start_of(seed) == 3)
    result = run_episode(Ramp(broken_at=2), Down(), seed)
    assert (result.outcome, result.failure, result.steps, result.distance) == ("failure", "no solution", 2, 2.0)


def test_an_episode_of_drawn_actions_follows_from_its_seed():
    env = Ramp()
    policy = Drawn(env.action_space)
    forth = [run_episode(env, policy, seed) for seed in range(5)]
    back = [run_episode(env, policy, seed) for seed in reversed(range(5))]
    assert forth == back[::-1]
    assert len({result.distance for result in forth}) > 1


def test_an_evaluation_sums_up():
    done = []
    found = evaluate(Ramp(), Down(), range(30), progress=done.append)
    assert tuple(done) == found.results
    starts = np.array([start_of(seed) for seed in range(30)])
    won = starts <= 6
    assert 0 < won.sum() < 30
    summary = found.summary()
    assert (summary["episodes"], summary["successes"], summary["time_limits"]) == (30, won.sum(), (~won).sum())
    assert summary["success_rate"] == pytest.approx(won.mean())
    assert summary["interval_95"][0] < won.mean() < summary["interval_95"][1]
    assert summary["steps"]["successes"] == {"mean": starts[won].mean(), "median": np.median(starts[won])}
    assert summary["steps"]["all"]["mean"] == pytest.approx(np.minimum(starts, 6).mean())
    assert found.mean_steps == summary["steps"]["all"]["mean"]
    assert summary["final_distance"]["mean"] == pytest.approx(np.maximum(starts - 6, 0).mean())


def interval(successes, episodes):
    results = (EpisodeResult(None, k < successes, 1, math.nan, math.nan) for k in range(episodes))
    return Evaluation(tuple(results)).interval


@pytest.mark.parametrize(
    ("successes", "episodes", "low", "high"),
    # Newcombe, "Two-sided confidence intervals for the single proportion", Stat. Med. 17 (1998), table I, method 3.
    [(81, 263, 0.2553, 0.3662), (15, 148, 0.0624, 0.1605), (0, 20, 0.0, 0.1611), (1, 29, 0.0061, 0.1718)],
)
def test_the_interval_is_that_of_the_table(successes, episodes, low, high):
    assert interval(successes, episodes) == pytest.approx((low, high), abs=5e-5)
    assert interval(episodes - successes, episodes) == pytest.approx((1 - high, 1 - low), abs=5e-5)


def test_the_ends_of_the_interval_are_exact():
    assert interval(0, 7)[0] == 0.0
    assert interval(7, 7)[1] == 1.0


def test_what_is_not_known_is_left_out():
    summary = Evaluation((EpisodeResult(1, False, 4, math.nan, math.nan),)).summary()
    assert summary["steps"]["successes"] == {"mean": None, "median": None}
    assert summary["final_distance"]["median"] is None


def test_no_episode_is_refused():
    with pytest.raises(ParameterError, match="results: got none"):
        evaluate(Ramp(), Down(), [])
    with pytest.raises(ParameterError, match="episodes: got 0"):
        evaluate_worlds(DummyVecEnv([Ramp]), Down(), 0)


@pytest.mark.parametrize(("worlds", "episodes"), [(1, 4), (4, 4), (3, 7), (5, 2)])
def test_worlds_run_as_many_episodes_each(worlds, episodes):
    counted = []
    found = evaluate_worlds(DummyVecEnv([Ramp] * worlds), Down(), episodes, seed=3, progress=counted.append)
    assert sorted(map(str, counted)) == sorted(map(str, found.results))
    expected = []
    for world in range(min(worlds, episodes)):
        env = Ramp()
        own = [run_episode(env, Down(), 3 + world)]
        for _ in range(episodes):
            state = env.reset()[0]
            steps = min(int(state[0]), 6)
            own.append(EpisodeResult(None, state[0] <= 6, steps, state[0] - steps, 0.0))
        expected.append(own)
    order = [(k, world) for k in range(episodes) for world in range(min(worlds, episodes))][:episodes]
    for result, (k, world) in zip(found.results, order, strict=True):
        own = expected[world][k]
        assert (result.seed, result.success, result.steps) == (own.seed, own.success, own.steps)
        assert result.distance == own.distance
