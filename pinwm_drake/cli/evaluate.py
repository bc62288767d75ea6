# SPDX-License-Identifier: MIT
"""`pinwm evaluate`: a bar of the episodes, and the results in a few lines."""

from typing import TYPE_CHECKING

from pinwm_drake.cli.console import Show, say, stages_bar
from pinwm_drake.experiments.requests.evaluate import MPC, EvaluateRun

if TYPE_CHECKING:
    from pinwm_drake.experiments.evaluation.run import EvaluationProgress, ProgressCallback


def evaluate(request: EvaluateRun) -> None:
    """Test a policy: success rate, number of actions, failures."""
    from pinwm_drake.experiments.evaluation import run
    from pinwm_drake.kernel_cache import announce_compiling
    from pinwm_drake.report.evaluation.report import details, headline

    done = 0
    try:
        if request.evaluation.engine == "twin" or request.evaluation.policy == MPC:
            announce_compiling()
        with stages_bar() as bars:
            show = _reporter(bars)

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
        say(f"interrupted after {done} episodes" + ("; go on with --resume" if run.can_go_on(request.out) else ""))
        raise SystemExit(1) from None
    say(headline(evaluation), style="bold")
    for line in details(evaluation):
        say(f"  {line}")
    for name in (run.SUMMARY_FILE, run.TABLE_FILE, run.VIDEO_FILE, run.REPORT_FILE):
        say(f"wrote {request.out / name}")


def _reporter(show: Show) -> "ProgressCallback":
    """Return the function that shows the progress of an evaluation: its episodes, then film and report."""
    begun = False

    def report(stands: "EvaluationProgress") -> None:
        nonlocal begun
        if not begun and stands.done:
            say(f"{stands.done} of {stands.total} episodes are done already")
        begun, found, figures = True, stands.evaluation, "getting ready"
        if found is not None:
            figures = f"success {100 * found.success_rate:.1f} %  {found.mean_steps:.1f} actions"
        if stands.drawn is None:
            show("evaluating", stands.done / stands.total, f"{stands.done}/{stands.total}  {figures}")
        else:
            show("drawing", stands.drawn, "film and report")

    return report
