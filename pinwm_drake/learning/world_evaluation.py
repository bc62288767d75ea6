# SPDX-License-Identifier: MIT
"""Success rate of a policy in many worlds at once, which is quick enough to do while it is trained."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
from stable_baselines3.common.vec_env import VecEnv

from pinwm_drake.errors import ParameterError
from pinwm_drake.learning.evaluation import Acts, EpisodeResult, Evaluation, result_of
from pinwm_drake.tasks.waypoints import Waypoints


def evaluate_worlds(
    env: VecEnv,
    policy: Acts,
    episodes: int,
    *,
    seed: int | None = None,
    progress: Callable[[EpisodeResult], None] = lambda result: None,
) -> Evaluation:
    """Run episodes in all worlds of a vectorised environment, which begins anew with this.

    The number of episodes of each world is settled beforehand, one more in the first worlds where it is not even.
    To take those that end first would favour the short ones, which are the successes. With as many episodes as worlds
    each world runs one, and no action is wasted but those of worlds that wait for the longest. All of them begin where
    the scene says, also in worlds of a training that begin elsewhere at times (`waypoints`, `continued`,
    `retries`).

    Args:
        env: The worlds; `infos` at the end of an episode have `distance`, `angle` and `success` or `is_success`.
        policy: Policy or controller that acts.
        episodes: Number of episodes, 1 or more.
        seed: Seed of the first world; world k is seeded with `seed + k`. None goes on with the generators, and so with
            other episodes.
        progress: Called with the result of each episode that counts.

    Returns:
        Results of the first episodes of all worlds, then of the second ones, and so on, whichever ended first; the
        first ones have their seeds.

    Raises:
        ParameterError: `episodes` is less than 1.
    """
    if episodes < 1:
        raise ParameterError(f"episodes: got {episodes}; allowed: 1 or more")
    with usual_starts(env):
        return _run(env, policy, episodes, seed, progress)


@contextmanager
def usual_starts(env: VecEnv) -> Iterator[None]:
    """Worlds whose episodes all begin where the scene says, for the time being."""
    usual = {"waypoints": Waypoints(), "continued": 0.0, "retries": 0.0}
    try:
        known = {name: value for name in usual if (value := env.get_attr(name)[0])}
    except AttributeError:  # worlds of no task
        known = {}
    for name in known:
        env.set_attr(name, usual[name])
    try:
        yield
    finally:
        for name, value in known.items():
            env.set_attr(name, value)


def _run(
    env: VecEnv, policy: Acts, episodes: int, seed: int | None, progress: Callable[[EpisodeResult], None]
) -> Evaluation:
    W = env.num_envs
    wanted = [(episodes + W - 1 - world) // W for world in range(W)]
    found: list[list[EpisodeResult]] = [[] for _ in range(W)]
    if seed is not None:
        env.seed(seed)
    observation, state = env.reset(), None
    steps, begins = np.zeros(W, int), np.ones(W, bool)
    while any(len(found[world]) < wanted[world] for world in range(W)):
        actions, state = policy.predict(observation, state=state, episode_start=begins, deterministic=True)
        observation, _, begins, infos = env.step(actions)
        steps += 1
        for world in np.flatnonzero(begins).tolist():
            if len(found[world]) < wanted[world]:
                own = seed + world if seed is not None and not found[world] else None
                found[world].append(result_of(infos[world], own, int(steps[world]), {}))
                progress(found[world][-1])
            steps[world] = 0
    order = [found[world][k] for k in range(max(wanted)) for world in range(W) if k < wanted[world]]
    return Evaluation(tuple(order))
