"""What `pinwm evaluate` does: runs episodes with a progress bar, and writes what came of them."""

from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from pinwm_drake.errors import ParameterError
from pinwm_drake.experiments.evaluation.contestant import read_contestant
from pinwm_drake.experiments.evaluation.episodes import EpisodeRunner, run_episodes
from pinwm_drake.experiments.evaluation.request import EvaluateRequest
from pinwm_drake.experiments.evaluation.results import (
    provenance_of,
    settings_of,
    story_of,
    write_episodes,
    write_evaluation,
)
from pinwm_drake.experiments.evaluation.store import EpisodeStore
from pinwm_drake.files import prepare_folder
from pinwm_drake.learning.evaluation import Evaluation
from pinwm_drake.parallel import Executor
from pinwm_drake.report.evaluation.episode import EpisodeRecord
from pinwm_drake.report.evaluation.report import EvaluationStory, details, headline, write_evaluation_report
from pinwm_drake.report.video import write_video
from pinwm_drake.systems.scenario.load import scene_hash
from pinwm_drake.threads import available

EPISODES = "episodes"
SUMMARY_FILE, TABLE_FILE, VIDEO_FILE, REPORT_FILE = "evaluation.json", "episodes.csv", "episodes.mp4", "report.html"
_PERIOD = 1800.0  # s, over which the time left is reckoned; an episode in a plant takes most of a minute


def run_evaluate(request: EvaluateRequest, out: Path, *, workers: int | None, resume: bool) -> None:
    """Evaluates a policy.

    Args:
        request: What is asked for.
        out: Folder of the results; made if need be.
        workers: Processes; None for one on each core.
        resume: Whether to go on with the episodes that are in `out`.

    Raises:
        PinwmError: An input was refused, or a file cannot be written.
        SystemExit: With 1, when the user interrupts (Ctrl-C).
    """
    if workers is not None and workers < 1:
        raise ParameterError(f"--workers: got {workers}; allowed: 1 or more")
    workers, console = workers or available(), Console()
    contestant = read_contestant(request)
    runner = EpisodeRunner(contestant, request)
    settings = settings_of(request, contestant, runner.env, scene_hash(runner.env.setup))
    store = EpisodeStore(prepare_folder(out) / EPISODES, settings, resume=resume)
    records = _all(console, runner, request, store, workers)
    evaluation = Evaluation(tuple(record.result for record in records))
    provenance = provenance_of(request, contestant, records, workers)
    write_evaluation(out / SUMMARY_FILE, evaluation, request.seeds, settings, provenance)
    write_episodes(out / TABLE_FILE, records, runner.env.task.q_WO)
    _show(console, out, story_of(request, runner.env, records, settings, provenance))
    console.print(headline(evaluation), style="bold", highlight=False, soft_wrap=True)
    for line in details(evaluation):
        console.print(f"  {line}", highlight=False, soft_wrap=True)
    for name in (SUMMARY_FILE, TABLE_FILE, VIDEO_FILE, REPORT_FILE):
        console.print(f"wrote {out / name}", highlight=False, soft_wrap=True, markup=False)


def _all(
    console: Console, runner: EpisodeRunner, request: EvaluateRequest, store: EpisodeStore, workers: int
) -> list[EpisodeRecord]:
    """Every episode in the order of the seeds, those that were there and those that were not."""
    found = {seed: record for seed in request.seeds if (record := store.read(seed)) is not None}
    if found:
        console.print(f"{len(found)} of {request.episodes} episodes are done already", highlight=False)
    columns = (
        TextColumn("evaluating"),
        BarColumn(bar_width=20),
        TextColumn("{task.completed:.0f}/{task.total:.0f}  {task.fields[figures]}"),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        TextColumn("left"),
    )
    with Progress(*columns, console=console, speed_estimate_period=_PERIOD) as bar:
        task = bar.add_task("", total=request.episodes, completed=len(found), figures=_figures(found))

        def tell(seed: int, record: EpisodeRecord) -> None:
            found[seed] = record
            bar.update(task, completed=len(found), figures=_figures(found))

        try:
            return run_episodes(runner, request, request.seeds, store, Executor(workers=workers), on_result=tell)
        except KeyboardInterrupt:
            pass
    console.print(f"interrupted after {len(found)} episodes; go on with --resume", highlight=False)
    raise SystemExit(1)


def _figures(found: dict[int, EpisodeRecord]) -> str:
    """What the bar tells of the episodes so far."""
    if not found:
        return "getting ready"
    so_far = Evaluation(tuple(record.result for record in found.values()))
    return f"success {100 * so_far.success_rate:.1f} %  {so_far.mean_steps:.1f} actions"


def _show(console: Console, out: Path, story: EvaluationStory) -> None:
    """Draws film and report."""
    columns = (TextColumn("drawing"), BarColumn(bar_width=20), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task("", total=1.0)
        grid = story.grid
        write_video(out / VIDEO_FILE, grid.pictures(), rate=1.0 / story.horizon, size=grid.size)
        bar.update(task, completed=0.5)
        write_evaluation_report(out / REPORT_FILE, story, lambda share: bar.update(task, completed=0.5 + 0.5 * share))
