# SPDX-License-Identifier: MIT
"""`pinwm train`: a bar for each stage of the training, and the files that it leaves."""

import math
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from rich.console import Console

from pinwm_drake.cli.console import duration, progress_bar, say
from pinwm_drake.experiments.requests.train import TrainRequest

if TYPE_CHECKING:
    from pinwm_drake.learning.progress import Report, Step


_LINES_PERIOD = 10.0  # s


def train(request: TrainRequest) -> None:
    """Trains a policy in cousins of a twin, with progress, checkpoints and TensorBoard."""
    from pinwm_drake.experiments import training
    from pinwm_drake.experiments.forecast import forecast
    from pinwm_drake.learning.policy import POLICY_FILE

    begun, out = time.monotonic(), request.out
    try:
        training.check_new(request)
        if not request.resume:
            say(f"this takes {forecast(request)} here; most end before")
        with _shown() as report:
            training.train(request, report=report)
    except KeyboardInterrupt:
        say(f"interrupted; go on with --resume (what is done is in {out})")
        raise SystemExit(1) from None
    took = (time.monotonic() - begun) / 60
    say(f"trained for {took:.1f} minutes in this run; wrote {out / training.FIGURE_FILE}")
    say(f"wrote {out / POLICY_FILE}; try it with: pinwm evaluate {out} --engine hydroelastic")


@contextmanager
def _shown() -> Iterator["Report"]:
    """Show the progress of a training: a bar for each stage on a terminal, otherwise a line now and then."""
    if not Console().is_terminal:
        yield _Lines()
        return
    with progress_bar("{task.percentage:.0f} %  {task.fields[figures]}", left="{task.fields[left]} left") as bar:
        tasks = {}

        def report(step: "Step") -> None:
            figures, left = _figures(step), duration(step.left)
            if step.stage not in tasks:
                tasks[step.stage] = bar.add_task(step.stage, total=1.0, figures=figures, left=left)
            bar.update(tasks[step.stage], completed=step.done, figures=figures, left=left)

        yield report


class _Lines:
    """Printer of lines on a training: at the beginning and the end of a round, and between every 10 s at most."""

    def __init__(self) -> None:
        self._last, self._evaluation = -math.inf, ""

    def __call__(self, step: "Step") -> None:
        """Print a line on the progress where one is due."""
        now, evaluation = time.monotonic(), f"{step.stage} {step.success} {step.length}"
        # A round has ended where its evaluation is another one.
        if evaluation == self._evaluation and step.done < 1.0 and now - self._last < _LINES_PERIOD:
            return
        self._last, self._evaluation = now, evaluation
        say(f"{step.stage} {step.done:4.0%}  {_figures(step)}  {duration(step.left)} left")


def _figures(step: "Step") -> str:
    """Text of the numbers of a training that are known."""
    if step.stage == "waypoints":
        return f"{step.steps} states of plans, of which the best did the task in {step.best:.0%} of its replays"
    if not step.steps:
        return "getting ready (the first run compiles for minutes)"
    words = [f"{step.steps:,} steps"]
    words += [] if math.isnan(step.rate) else [f"{step.rate:.0f} steps/s"]
    words += [] if math.isnan(step.loss) else [f"loss {step.loss:.4f}"]
    words += [] if math.isnan(step.recent) else [f"success in training {step.recent:.0%}"]
    if not math.isnan(step.success):
        words.append(f"success {step.success:.0%} in {step.length:.0f} actions, best {step.best:.0%}")
    return "  ".join(words)
