# SPDX-License-Identifier: MIT
"""`pinwm rehearse`: a bar, and the table of faults."""

from typing import TYPE_CHECKING

from rich.console import Console
from rich.table import Table

from pinwm_drake.cli.console import say, stages_bar
from pinwm_drake.experiments.requests.control import RehearseRun

if TYPE_CHECKING:
    from pinwm_drake.experiments.rehearsal.run import Trial


def rehearse(request: RehearseRun) -> None:
    """Rehearse a bundle with a simulated arm, and with faults.

    The arm is a process of its own behind LCM, in real time. A fault has to stop the robot in time.
    Exits with 1 where a trial went wrong.
    """
    from pinwm_drake.experiments.rehearsal.report import REPORT_FILE, write_rehearsal_report
    from pinwm_drake.experiments.rehearsal.run import TRIALS_FILE, scene_words, shortfall, summary
    from pinwm_drake.experiments.rehearsal.run import rehearse as run

    rehearsal, out = request.rehearsal, request.out
    short = shortfall(rehearsal)
    if short:
        say(f"the arm is slower than the policy was trained for: {short}")
    done, bad = 0, 0
    try:
        with stages_bar() as show:
            show("rehearsal", 0.0, "the arm begins")

            def report(number: int, share: float, trial: "Trial") -> None:
                nonlocal done, bad
                done, bad = number, bad + (not trial.good)
                figures = f"{done} trials, {bad} went wrong; the last: {trial.kind or 'normal work'}, {trial.state}"
                show("rehearsal", share, figures)

            trials = run(rehearsal, out, resume=request.resume, report=report)
    except KeyboardInterrupt:
        kept = "; go on with --resume" if (out / TRIALS_FILE).is_file() else ""
        say(f"interrupted after {done} trials{kept}")
        raise SystemExit(1) from None
    Console().print(_table(summary(trials)))
    write_rehearsal_report(out / REPORT_FILE, rehearsal, trials, scene_words(rehearsal))
    say(f"wrote {out / REPORT_FILE}")
    wrong = [trial for trial in trials if not trial.good]
    for trial in wrong[:10]:
        say(f"went wrong: {_words(trial)}")
    if wrong:
        raise SystemExit(1)


def _words(trial: "Trial") -> str:
    """Return what happened in a trial that went wrong."""
    name = trial.kind or "normal work"
    if not trial.kind:
        return f"{name}, seed {trial.seed}: stopped after {trial.duration:.1f} s: {trial.reason}"
    if trial.after is None:
        return f"{name}, seed {trial.seed}: the controller ended before the fault: {trial.state}: {trial.reason}"
    rest = "" if trial.zero and trial.at_rest else "; the robot is not at rest"
    took = f"zero after {trial.to_zero:.3f} s, allowed {trial.allowed:.3f} s"
    return f"{name}, seed {trial.seed}: {trial.state}, {took}{rest}"


def _table(found: dict) -> Table:
    """Table of the faults, and of normal work."""
    table = Table("fault", "trials", "stopped in time", "median [s]", "longest [s]", "allowed [s]")
    for name, one in found["faults"].items():
        times = (f"{one[key]:.3f}" for key in ("median_to_zero", "longest_to_zero", "allowed"))
        table.add_row(name, str(one["trials"]), str(one["good"]), *times)
    if "normal" in found:
        one = found["normal"]
        words = f"{one['successes']} at the goal, {one['false_stops']} false stops"
        table.add_row("normal work", str(one["episodes"]), words, "", "", "")
    return table
