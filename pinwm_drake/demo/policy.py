"""An episode of the policy that ships, in one engine."""

from dataclasses import dataclass

import torch

from pinwm_drake.experiments.evaluation.contestant import read_contestant
from pinwm_drake.experiments.evaluation.episodes import EpisodeRunner
from pinwm_drake.experiments.evaluation.request import EvaluateRequest
from pinwm_drake.experiments.evaluation.results import episode_film
from pinwm_drake.report.evaluation.episode import EpisodeRecord
from pinwm_drake.report.evaluation.film import EpisodeFilm

_HEIGHT = 320  # px, of the film


@dataclass(frozen=True, eq=False)
class Performance:
    """An episode and what is needed to show it.

    Attributes:
        engine: "twin" or "hydroelastic".
        record: The episode.
        film: Draws it.
        horizon: Duration of an action [s].
        tolerance: Distance from the goal within which the episode succeeds [m].
    """

    engine: str
    record: EpisodeRecord
    film: EpisodeFilm
    horizon: float
    tolerance: float


def run_policy(bundle: str, scene: str, engine: str, *, seed: int, max_steps: int | None = None) -> Performance:
    """Lets a bundle's policy act in one episode.

    Args:
        bundle: The name of a policy that ships, or a folder.
        scene: The name of a scenario that ships, or the folder of a twin.
        engine: "twin" or "hydroelastic".
        seed: Of the start.
        max_steps: Actions at most; None for the policy's own limit.

    Raises:
        PinwmError: The policy or the scene cannot be used.
    """
    request = EvaluateRequest(bundle, scene=scene, engine=engine, episodes=1, seed=seed, max_steps=max_steps)
    threads = torch.get_num_threads()
    torch.set_num_threads(1)  # torch's idle threads would take the cores from the physics
    try:
        runner = EpisodeRunner(read_contestant(request), request)
        record = runner.run(seed)
    finally:
        torch.set_num_threads(threads)
    env = runner.env
    return Performance(engine, record, episode_film(env, _HEIGHT), env.setup.period, env.task.tolerance)
