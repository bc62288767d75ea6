# SPDX-License-Identifier: MIT
"""Success rate of a policy, by one episode after another in a gymnasium environment."""

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, Protocol

import gymnasium
import numpy as np
from scipy.stats import binomtest

from pinwm_drake.errors import ParameterError


class Acts(Protocol):
    """Anything that acts and can be evaluated: a policy, a bundle, a controller or a model of Stable-Baselines3."""

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[np.ndarray, Any]:
        """Actions (n,) or (W, n) in [-1, 1]^n, and the state that the policy is to be given with the next observation.

        Args:
            observation: Observation of one environment, or of W.
            state: The state that came back last; None at first.
            episode_start: (W,) bool, true where an episode begins.
            deterministic: Flag: the policy does not draw its actions; true in every evaluation.
        """


@dataclass(frozen=True)
class EpisodeResult:
    """Result of one episode.

    Attributes:
        seed: Seed of the episode; None where it went on with an earlier generator.
        success: Flag: the episode ended with success, by the environment's `info`.
        steps: Number of actions taken.
        distance: m, distance of the object from the goal at the end; NaN where the environment gives none.
        angle: rad, angle between the object's orientation and the goal's at the end; NaN likewise.
        failure: Reason why the physics failed; empty where it did not.
        start_distance: m, distance from the goal at the start; NaN likewise.
        start_angle: rad, angle from the goal at the start; NaN likewise.
        coverage: Share of the goal's outline that the object covers at the end, from above; NaN where there is none.
    """

    seed: int | None
    success: bool
    steps: int
    distance: float
    angle: float
    failure: str = ""
    start_distance: float = math.nan
    start_angle: float = math.nan
    coverage: float = math.nan

    @property
    def outcome(self) -> str:
        """Outcome of the episode: "success", "time limit", or "failure" of the physics, or of a pusher's force."""
        if self.success:
            return "success"
        return "failure" if self.failure else "time limit"


@dataclass(frozen=True)
class Evaluation:
    """Results of several episodes, and the figures that follow from them.

    Attributes:
        results: Result of each episode, 1 or more.

    Raises:
        ParameterError: There are none.
    """

    results: tuple[EpisodeResult, ...]

    def __post_init__(self) -> None:
        if not self.results:
            raise ParameterError("results: got none; allowed: 1 episode or more")

    @property
    def episodes(self) -> int:
        """Number of episodes."""
        return len(self.results)

    @property
    def successes(self) -> int:
        """Number of episodes that succeeded."""
        return sum(result.success for result in self.results)

    @property
    def success_rate(self) -> float:
        """Share of successful episodes, 0 to 1."""
        return self.successes / self.episodes

    @property
    def interval(self) -> tuple[float, float]:
        """Wilson's 95 % interval of the success rate: both ends, 0 to 1."""
        low, high = binomtest(self.successes, self.episodes).proportion_ci(method="wilson")
        return float(low), float(high)

    def steps(self, *, successful: bool = False) -> np.ndarray:
        """Numbers (n,) int of the actions of each episode, in order.

        Args:
            successful: Flag: episodes that succeeded alone; otherwise those that failed count the actions they took.
        """
        return np.array([result.steps for result in self.results if result.success or not successful], int)

    @property
    def mean_steps(self) -> float:
        """Mean number of actions, over all episodes."""
        return float(self.steps().mean())

    def summary(self) -> dict[str, Any]:
        """Figures of all episodes as plain data: counts, rates, m and rad; None for a mean or median of nothing."""
        outcomes = [result.outcome for result in self.results]
        return {
            "episodes": self.episodes,
            "successes": self.successes,
            "success_rate": self.success_rate,
            "interval_95": list(self.interval),
            "time_limits": outcomes.count("time limit"),
            "failures": outcomes.count("failure"),
            "steps": {"successes": _middle(self.steps(successful=True)), "all": _middle(self.steps())},
            "final_distance": _middle([result.distance for result in self.results]),
            "final_angle": _middle([result.angle for result in self.results]),
            "within_10_mm_and_0.1_rad": sum(one.distance <= 0.01 and one.angle <= 0.1 for one in self.results),
            "coverage": _middle([result.coverage for result in self.results]),
        }


def run_episode(
    env: gymnasium.Env, policy: Acts, seed: int, *, watch: Callable[[Any], None] = lambda observation: None
) -> EpisodeResult:
    """Run an episode, all of which follows from its seed.

    Args:
        env: Its `info` has `distance`, `angle` and `success`, and `failure` where there is one. Its action space is
            seeded too, for policies that draw from it.
        policy: Policy or controller that acts; `episode_start` is true in the first step, as in Stable-Baselines3.
        seed: Seed of the episode.
        watch: Called with every observation, the first and the last included.

    Returns:
        The result.
    """
    observation, info = env.reset(seed=seed)
    env.action_space.seed(seed)
    start, state, steps, ended = info, None, 0, False
    watch(observation)
    while not ended:
        action, state = policy.predict(
            observation, state=state, episode_start=np.array([steps == 0]), deterministic=True
        )
        observation, _, terminated, truncated, info = env.step(action)
        steps, ended = steps + 1, bool(terminated or truncated)
        watch(observation)
    return result_of(info, seed, steps, start)


def result_of(info: dict[str, Any], seed: int | None, steps: int, start: dict[str, Any]) -> EpisodeResult:
    """Return the result of an episode, from its last `info`, and from that of its start."""
    return EpisodeResult(
        seed=seed,
        success=bool(info.get("success", info.get("is_success", False))),
        steps=steps,
        distance=float(info.get("distance", math.nan)),
        angle=float(info.get("angle", math.nan)),
        failure=str(info.get("failure", "")),
        start_distance=float(start.get("distance", math.nan)),
        start_angle=float(start.get("angle", math.nan)),
    )


def evaluate(
    env: gymnasium.Env,
    policy: Acts,
    seeds: Iterable[int],
    *,
    progress: Callable[[EpisodeResult], None] = lambda result: None,
) -> Evaluation:
    """Run one episode for each seed.

    Args:
        env: The environment; see `run_episode`.
        policy: Policy or controller that acts.
        seeds: Seeds of the episodes.
        progress: Called with the result of each episode, after it.

    Raises:
        ParameterError: There are no seeds.
    """
    results = []
    for seed in seeds:
        results.append(run_episode(env, policy, seed))
        progress(results[-1])
    return Evaluation(tuple(results))


def _middle(values: Any) -> dict[str, float | None]:
    """Mean and median of the finite ones among some values; None where there is none."""
    numbers = np.asarray(values, float)
    numbers = numbers[np.isfinite(numbers)]
    if not len(numbers):
        return {"mean": None, "median": None}
    return {"mean": float(numbers.mean()), "median": float(np.median(numbers))}
