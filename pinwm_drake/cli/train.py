# SPDX-License-Identifier: MIT
"""`pinwm train`: a bar for each stage of the training, and the files that it leaves."""

import math
import time
from typing import TYPE_CHECKING

from pinwm_drake.cli.console import Show, say, stages_bar
from pinwm_drake.experiments.requests.train import TrainRequest

if TYPE_CHECKING:
    from pinwm_drake.learning.progress import Report, Step


_FEW = 0.05  # share of a plan's replays that is hardly enough to learn from
_ADVICE = "friction at pusher or floor may be too low, or the pusher too slow, to do it"


def train(request: TrainRequest) -> None:
    """Train a policy in randomised copies of a twin.

    The copies are drawn around the twin, or from its posterior. Checkpoints let an interrupted run go on.
    """
    from pinwm_drake.experiments import training
    from pinwm_drake.experiments.forecast import forecast
    from pinwm_drake.files import occupying
    from pinwm_drake.learning.policy import POLICY_FILE

    begun, out = time.monotonic(), request.out
    try:
        training.check_new(request)
        with occupying(out):  # before the forecast, which takes a while
            if not request.resume:
                for name, (low, high) in training.wide_frictions(request).items():
                    option = f"--{name.replace('_', '-')}"
                    say(f"{name} is {low:.2g} to {high:.2g}: each episode draws its own; {option} sets a range")
                for doubt in training.doubts(request):
                    say(f"warning: {doubt}")
                with stages_bar(transient=True) as show:
                    show("forecasting", 0.0, "a brief training of each stage")
                    found = forecast(
                        request, lambda share: show("forecasting", share, "a brief training of each stage")
                    )
                say(f"this takes {found} here; most trainings end earlier, when the success no longer rises")
                if training.searches(request):
                    say("the search for plans to begin from comes first and is not counted")
            with stages_bar() as show:
                training.train(request, report=_reporter(show))
    except KeyboardInterrupt:
        kept = training.can_go_on(out)
        say(f"interrupted; go on with --resume (what is done is in {out})" if kept else "interrupted; nothing is kept")
        raise SystemExit(1) from None
    took = (time.monotonic() - begun) / 60
    say(f"trained for {took:.1f} minutes in this run; wrote {out / training.FIGURE_FILE}")
    say(f"wrote {out / POLICY_FILE}; try it with: pinwm evaluate {out} --engine hydroelastic")


def _reporter(show: Show) -> "Report":
    """Return the function that shows the steps of a training; the end of a round always has a line."""
    evaluated, planned = "", math.nan

    def report(step: "Step") -> None:
        nonlocal evaluated, planned
        if step.stage == "waypoints":
            planned = step.best
        elif planned < _FEW:
            say(f"the best plan does the task in {planned:.0%} of its replays: expect a poor policy; {_ADVICE}")
            planned = math.nan
        # A round has ended where its evaluation is another one.
        evaluation = f"{step.stage} {step.success} {step.length}"
        show(step.stage, step.done, _figures(step), step.left, tell=evaluation != evaluated)
        evaluated = evaluation

    return report


def _figures(step: "Step") -> str:
    """Text of the numbers of a training that are known."""
    if step.stage == "waypoints":
        return f"{step.steps} states of plans, of which the best did the task in {step.best:.0%} of its replays"
    if not step.steps:
        return "getting ready"
    words = [f"{step.steps:,} steps"]
    words += [] if math.isnan(step.rate) else [f"{step.rate:.0f} steps/s"]
    words += [] if math.isnan(step.loss) else [f"loss {step.loss:.4f}"]
    words += [] if math.isnan(step.recent) else [f"success in training {step.recent:.0%}"]
    if not math.isnan(step.success):
        words.append(f"success {step.success:.0%} in {step.length:.0f} actions, best {step.best:.0%}")
    return "  ".join(words)
