# SPDX-License-Identifier: MIT
"""An episode of the policy that ships, in one engine."""

from dataclasses import dataclass
from typing import Literal

from pinwm_drake.demo.options import DemoOptions
from pinwm_drake.experiments.evaluation.contestant import read_contestant
from pinwm_drake.experiments.evaluation.episodes import EpisodeRunner
from pinwm_drake.experiments.evaluation.results import episode_film
from pinwm_drake.experiments.requests.evaluate import EvaluateRequest
from pinwm_drake.report.evaluation.episode import EpisodeRecord
from pinwm_drake.report.evaluation.film import EpisodeFilm
from pinwm_drake.threads import one_torch_thread

_HEIGHT = 320  # px, of the film


@dataclass(frozen=True, eq=False)
class Performance:
    """An episode and what is needed to show it."""

    engine: str  # "twin" or "hydroelastic"
    record: EpisodeRecord
    film: EpisodeFilm
    horizon: float  # s, that an action takes


def run_policy(options: DemoOptions, scene: str, engine: Literal["twin", "hydroelastic"]) -> Performance:
    """Let the policy act in one episode of a scene: the name of one that ships, or the folder of a twin.

    Raises:
        PinwmError: The policy or the scene cannot be used.
    """
    request = EvaluateRequest(
        options.policy, scene=scene, engine=engine, episodes=1, seed=options.seed, max_steps=options.max_steps
    )
    with one_torch_thread():
        runner = EpisodeRunner(read_contestant(request), request)
        record = runner.run(options.seed)
    env = runner.env
    return Performance(engine, record, episode_film(env, _HEIGHT), env.setup.period)
