# SPDX-License-Identifier: MIT
"""The evaluation of a policy: episodes that are kept as they end, and the files that tell of them."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from pinwm_drake.errors import require
from pinwm_drake.experiments.evaluation.contestant import read_contestant, scene_of
from pinwm_drake.experiments.evaluation.episodes import EpisodeRunner, run_episodes
from pinwm_drake.experiments.evaluation.results import (
    lying,
    provenance_of,
    settings_of,
    story_of,
    write_episodes,
    write_evaluation,
)
from pinwm_drake.experiments.evaluation.store import EpisodeStore
from pinwm_drake.experiments.requests.evaluate import EvaluateRequest
from pinwm_drake.files import occupying
from pinwm_drake.learning.evaluation import Evaluation
from pinwm_drake.parallel import Executor
from pinwm_drake.report.evaluation.episode import EpisodeRecord
from pinwm_drake.report.evaluation.report import EvaluationStory, write_evaluation_report
from pinwm_drake.report.video import write_video
from pinwm_drake.systems.scenario.load import scene_hash

EPISODES = "episodes"
SUMMARY_FILE, TABLE_FILE, VIDEO_FILE, REPORT_FILE = "evaluation.json", "episodes.csv", "episodes.mp4", "report.html"


@dataclass(frozen=True)
class EvaluationProgress:
    """The state of an evaluation that goes on.

    Attributes:
        done: Episodes that have ended, those of an earlier run included.
        total: Episodes that are asked for.
        evaluation: Evaluation of the episodes that have ended; None before the first.
        drawn: Share of film and report that is drawn, 0 to 1; None while episodes run.
    """

    done: int
    total: int
    evaluation: Evaluation | None
    drawn: float | None = None


ProgressCallback = Callable[[EvaluationProgress], None]


def evaluate(
    request: EvaluateRequest,
    out: Path | str,
    *,
    workers: int | None = None,
    executor: str = "joblib",
    resume: bool = False,
    progress: ProgressCallback = lambda progress: None,
) -> Evaluation:
    """Evaluate a policy and write episodes, `evaluation.json`, `episodes.csv`, `episodes.mp4` and `report.html`.

    Args:
        request: The policy, its scene and the episodes.
        out: Folder of the results; made if need be.
        workers: Processes, which do not change the results; None for one on each core, as memory allows.
        executor: "joblib" or "ray", which runs them.
        resume: Whether to go on with the episodes that are in `out`.
        progress: Called before the first episode, after each, and while film and report are drawn.

    Returns:
        The episodes' results, in the order of their seeds.

    Raises:
        PinwmError: An input was refused, or a file cannot be written.
    """
    out = Path(out)
    require("--workers", workers, workers is None or workers >= 1, "1 or more")
    processes = Executor(executor, workers=workers)
    number = processes.number(request.episodes)
    contestant = read_contestant(request)
    runner = EpisodeRunner(contestant, request)
    believed = scene_of(contestant, request) if request.stand_in else runner.env.setup
    settings = settings_of(request, contestant, runner.env, scene_hash(believed))
    with occupying(out):
        store = EpisodeStore(out / EPISODES, settings, resume=resume)
        records = _run_all(runner, request, store, processes, progress)
        evaluation = _evaluation(records)
        provenance = provenance_of(request, contestant, runner.env, records, number)
        write_evaluation(out / SUMMARY_FILE, evaluation, request.seeds, settings, provenance)
        write_episodes(out / TABLE_FILE, records, lying(runner.env))
        done = len(records)
        _draw(
            out,
            story_of(request, believed, runner.env, records, settings, provenance),
            lambda share: progress(EvaluationProgress(done, done, evaluation, share)),
        )
        return evaluation


def can_go_on(out: Path) -> bool:
    """Flag: a folder holds episodes that an evaluation goes on with by `resume`."""
    return any((out / EPISODES).glob("*.npz"))


def _run_all(
    runner: EpisodeRunner, request: EvaluateRequest, store: EpisodeStore, executor: Executor, progress: ProgressCallback
) -> list[EpisodeRecord]:
    """Every episode in the order of the seeds, those that were there and those that were not."""
    found = {seed: record for seed in request.seeds if (record := store.read(seed)) is not None}

    def tell() -> None:
        so_far = _evaluation(list(found.values())) if found else None
        progress(EvaluationProgress(len(found), request.episodes, so_far))

    def add(seed: int, record: EpisodeRecord) -> None:
        if seed not in found:
            found[seed] = record
            tell()

    tell()
    return run_episodes(runner, request, request.seeds, store, executor, on_result=add)


def _evaluation(records: list[EpisodeRecord]) -> Evaluation:
    return Evaluation(tuple(record.result for record in records))


def _draw(out: Path, story: EvaluationStory, progress: Callable[[float], None]) -> None:
    grid = story.grid
    progress(0.0)
    write_video(out / VIDEO_FILE, grid.pictures(), rate=1.0 / story.horizon, size=grid.size)
    progress(0.5)
    write_evaluation_report(out / REPORT_FILE, story, lambda share: progress(0.5 + 0.5 * share))
