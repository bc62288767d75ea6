# SPDX-License-Identifier: MIT
import numpy as np
import pytest

from pinwm_drake.learning.evaluation import evaluate
from pinwm_drake.learning.world_evaluation import evaluate_worlds
from pinwm_drake.systems.envs.env import TaskEnv
from pinwm_drake.systems.envs.vector import TaskVecEnv
from tests.systems.stations import setup_of

OPTIONS = {"max_steps": 8, "max_translation": 0.01, "task": {"tolerance": 0.04, "turn_tolerance": 0.3}}


class Towards:
    """Moves the pusher to the object's origin, which the state tells, and away where that is 30 mm from the goal."""

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        seen = np.atleast_2d(observation)
        forth = np.hypot(*seen[:, 0:2].T) > 0.3
        actions = np.clip(np.where(forth[:, None], 1.0, -1.0) * (seen[:, 0:2] - seen[:, 9:11]), -1.0, 1.0)
        return (actions[0] if np.ndim(observation) == 1 else actions), None


@pytest.fixture(scope="module")
def single():
    return evaluate(TaskEnv(setup_of(), "twin", **OPTIONS), Towards(), range(20, 25))


def test_worlds_give_what_an_environment_gives(single):
    assert len({result.outcome for result in single.results}) == 2
    found = evaluate_worlds(TaskVecEnv(setup_of(), 5, **OPTIONS), Towards(), 5, seed=20)
    for one, other in zip(found.results, single.results, strict=True):
        assert (one.seed, one.success, one.steps) == (other.seed, other.success, other.steps)
        assert (one.distance, one.angle) == (other.distance, other.angle)


def test_it_can_be_done_again_and_is_the_same(single):
    env = TaskVecEnv(setup_of(), 3, **OPTIONS)
    once, again = (evaluate_worlds(env, Towards(), 7, seed=20) for _ in range(2))
    assert once == again
    assert [result.steps for result in once.results[:3]] == [result.steps for result in single.results[:3]]


def test_the_order_of_episodes_does_not_matter(single):
    env = TaskEnv(setup_of(), "point", **OPTIONS)
    forth, back = evaluate(env, Towards(), [20, 21]), evaluate(env, Towards(), [21, 20])
    assert forth.results == back.results[::-1]
    assert [result.start_angle for result in forth.results] == [result.start_angle for result in single.results[:2]]
