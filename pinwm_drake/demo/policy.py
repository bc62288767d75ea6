"""An episode of the policy that ships, in one engine."""

import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import torch

from pinwm_drake.demo.options import DemoOptions
from pinwm_drake.experiments.evaluation.contestant import read_contestant
from pinwm_drake.experiments.evaluation.episodes import EpisodeRunner
from pinwm_drake.experiments.evaluation.results import episode_film
from pinwm_drake.experiments.requests.evaluate import EvaluateRequest
from pinwm_drake.geometry.meshes import load_mesh
from pinwm_drake.report.evaluation.episode import EpisodeRecord
from pinwm_drake.report.evaluation.film import EpisodeFilm
from pinwm_drake.systems.sdf.colours import coloured_mesh

_HEIGHT = 320  # px, of the film


@dataclass(frozen=True, eq=False)
class Performance:
    """An episode and what is needed to show it.

    Attributes:
        engine: "twin" or "hydroelastic".
        record: The episode.
        film: Draws it.
        horizon: Duration of an action [s].
    """

    engine: str
    record: EpisodeRecord
    film: EpisodeFilm
    horizon: float


def run_policy(options: DemoOptions, scene: str, engine: Literal["twin", "hydroelastic"]) -> Performance:
    """Lets the policy act in one episode.

    Args:
        options: The policy, and the seed and the longest length of the episode.
        scene: The name of a scenario that ships, or the folder of a twin.
        engine: "twin" or "hydroelastic".

    Raises:
        PinwmError: The policy or the scene cannot be used.
    """
    request = EvaluateRequest(
        options.policy, scene=scene, engine=engine, episodes=1, seed=options.seed, max_steps=options.max_steps
    )
    threads = torch.get_num_threads()
    torch.set_num_threads(1)  # torch's idle threads would take the cores from the physics
    try:
        runner = EpisodeRunner(read_contestant(request), request)
        record = runner.run(options.seed)
    finally:
        torch.set_num_threads(threads)
    env = runner.env
    if engine != "twin":
        return Performance(engine, record, episode_film(env, _HEIGHT), env.setup.period)
    # The twin is drawn in the colours of its surfels.
    twin = env.setup.twin
    mesh, colours = coloured_mesh(load_mesh(twin.mesh_path), twin.surfels, "object.mtl")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "object.obj"
        path.write_text(mesh, encoding="utf-8")
        path.with_suffix(".mtl").write_text(colours, encoding="utf-8")
        return Performance(engine, record, episode_film(env, _HEIGHT, path), env.setup.period)
