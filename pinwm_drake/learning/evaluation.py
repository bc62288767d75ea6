"""How often a policy succeeds: one episode after another in a gymnasium environment."""

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, Protocol

import gymnasium
import numpy as np

from pinwm_drake.errors import ParameterError
from pinwm_drake.learning.wilson import wilson_interval


class Acts(Protocol):
    """What can be evaluated: a policy, a bundle, a controller or a model of Stable-Baselines3."""

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[np.ndarray, Any]:
        """Actions, and what the policy wants to be given with the next observation.

        Args:
            observation: Of one environment, or of several.
            state: What came back last; None at first.
            episode_start: (W,) bool, where an episode begins.
            deterministic: Asked for always.
        """


@dataclass(frozen=True)
class EpisodeResult:
    """How an episode went.

    Attributes:
        seed: Of the episode; None where it went on with an earlier generator.
        success: Whether the environment says so.
        steps: Actions taken.
        distance: m, of the object from the goal at the end; not a number where the environment does not say.
        angle: rad, likewise.
        failure: Why the physics failed; empty where it did not.
        start_distance: m, at the start.
        start_angle: rad, at the start.
    """

    seed: int | None
    success: bool
    steps: int
    distance: float
    angle: float
    failure: str = ""
    start_distance: float = math.nan
    start_angle: float = math.nan

    @property
    def outcome(self) -> str:
        """One of "success", "time limit" and "failure", which is that of the physics."""
        if self.success:
            return "success"
        return "failure" if self.failure else "time limit"


@dataclass(frozen=True)
class Evaluation:
    """What episodes came to.

    Attributes:
        results: Of each episode, 1 or more.

    Raises:
        ParameterError: There are none.
    """

    results: tuple[EpisodeResult, ...]

    def __post_init__(self) -> None:
        """Checks that there are some."""
        if not self.results:
            raise ParameterError("results: got none; allowed: 1 episode or more")

    @property
    def episodes(self) -> int:
        """How many there were."""
        return len(self.results)

    @property
    def successes(self) -> int:
        """How many succeeded."""
        return sum(result.success for result in self.results)

    @property
    def success_rate(self) -> float:
        """0 to 1."""
        return self.successes / self.episodes

    @property
    def interval(self) -> tuple[float, float]:
        """The rate's 95 % interval, after Wilson."""
        return wilson_interval(self.successes, self.episodes)

    def steps(self, *, successful: bool = False) -> np.ndarray:
        """Actions of each episode, or of each that succeeded: (n,) int. One that failed counts what it took."""
        return np.array([result.steps for result in self.results if result.success or not successful], int)

    @property
    def mean_steps(self) -> float:
        """Over all episodes."""
        return float(self.steps().mean())

    def summary(self) -> dict[str, Any]:
        """The figures as plain data; None where there is nothing to tell of."""
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
        }


def run_episode(
    env: gymnasium.Env, policy: Acts, seed: int, *, watch: Callable[[Any], None] = lambda observation: None
) -> EpisodeResult:
    """Runs an episode, all of which follows from its seed.

    Args:
        env: Its `info` has `distance`, `angle` and `success`, and `failure` where there is one. Its action space is
            seeded too, for policies that draw from it.
        policy: What acts; `episode_start` is true in the first step, as Stable-Baselines3 has it.
        seed: Of the episode.
        watch: Called with every observation, the first and the last included.
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
    """The result of an episode from its last `info`, and from the first one."""
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
    """Runs one episode for each seed.

    Args:
        env: See `run_episode`.
        policy: What acts.
        seeds: Of the episodes.
        progress: Called after each.

    Raises:
        ParameterError: There are no seeds.
    """
    results = []
    for seed in seeds:
        results.append(run_episode(env, policy, seed))
        progress(results[-1])
    return Evaluation(tuple(results))


def _middle(values: Any) -> dict[str, float | None]:
    """Mean and median of those that are numbers."""
    numbers = np.asarray(values, float)
    numbers = numbers[np.isfinite(numbers)]
    if not len(numbers):
        return {"mean": None, "median": None}
    return {"mean": float(numbers.mean()), "median": float(np.median(numbers))}
