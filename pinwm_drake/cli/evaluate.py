# SPDX-License-Identifier: MIT
"""`pinwm evaluate`: a bar of the episodes, and the results in a few lines."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from pinwm_drake.cli.console import progress_bar, say
from pinwm_drake.experiments.requests.evaluate import EvaluateRun

if TYPE_CHECKING:
    from pinwm_drake.experiments.evaluation.run import EvaluationProgress, ProgressCallback


def evaluate(request: EvaluateRun) -> None:
    """Test a policy: how often it succeeds, how soon, and what failed."""
    from pinwm_drake.experiments.evaluation import run
    from pinwm_drake.report.evaluation.report import details, headline

    done = 0
    try:
        with _shown() as show:

            def progress(stands: "EvaluationProgress") -> None:
                nonlocal done
                done = stands.done
                show(stands)

            evaluation = run.evaluate(
                request.evaluation,
                request.out,
                workers=request.workers,
                executor=request.executor,
                resume=request.resume,
                progress=progress,
            )
    except KeyboardInterrupt:
        say(f"interrupted after {done} episodes; go on with --resume")
        raise SystemExit(1) from None
    say(headline(evaluation), style="bold")
    for line in details(evaluation):
        say(f"  {line}")
    for name in (run.SUMMARY_FILE, run.TABLE_FILE, run.VIDEO_FILE, run.REPORT_FILE):
        say(f"wrote {request.out / name}")


@contextmanager
def _shown() -> Iterator["ProgressCallback"]:
    """Show the progress of an evaluation: a bar of its episodes, then one of film and report."""
    with progress_bar("{task.fields[figures]}") as bar:
        tasks = {}

        def task(name: str, completed: float, total: float, figures: str) -> None:
            if name not in tasks:
                tasks[name] = bar.add_task(name, total=total, completed=int(completed), figures=figures)
            bar.update(tasks[name], completed=completed, figures=figures)

        def show(stands: "EvaluationProgress") -> None:
            if "evaluating" not in tasks and stands.done:
                bar.console.print(f"{stands.done} of {stands.total} episodes are done already", highlight=False)
            found, figures = stands.evaluation, "getting ready"
            if found is not None:
                figures = f"success {100 * found.success_rate:.1f} %  {found.mean_steps:.1f} actions"
            if stands.drawn is None:
                task("evaluating", stands.done, stands.total, f"{stands.done}/{stands.total}  {figures}")
            else:
                task("drawing", stands.drawn, 1.0, f"{stands.drawn:.0%}")

        yield show
