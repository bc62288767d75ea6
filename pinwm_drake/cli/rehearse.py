# SPDX-License-Identifier: MIT
"""`pinwm rehearse`: a bar, and the table of faults."""

from typing import TYPE_CHECKING

from rich.console import Console
from rich.table import Table

from pinwm_drake.cli.console import progress_bar, say
from pinwm_drake.experiments.requests.control import RehearseRun

if TYPE_CHECKING:
    from pinwm_drake.experiments.rehearsal.run import Trial


def rehearse(request: RehearseRun) -> None:
    """Rehearses a bundle with a simulated arm over LCM in real time: normal work, or faults that have to stop it."""
    from pinwm_drake.experiments.rehearsal.report import REPORT_FILE, write_rehearsal_report
    from pinwm_drake.experiments.rehearsal.run import rehearse as run
    from pinwm_drake.experiments.rehearsal.run import shortfall, summary

    rehearsal, out = request.rehearsal, request.out
    short = shortfall(rehearsal)
    if short:
        say(f"the arm is slower than the policy was trained for: {short}")
    done, bad = 0, 0
    try:
        with progress_bar("{task.completed:.0f} trials  {task.fields[figures]}") as bar:
            task = bar.add_task("rehearsal", total=None, figures="the arm begins")

            def report(number: int, total: int, trial: "Trial") -> None:
                nonlocal done, bad
                done, bad = number, bad + (not trial.good)
                figures = f"{bad} not as they should be; {trial.kind or 'normal work'}: {trial.state}"
                bar.update(task, completed=number, total=max(total, number) if total else None, figures=figures)

            trials = run(rehearsal, out, resume=request.resume, report=report)
    except KeyboardInterrupt:
        say(f"interrupted after {done} trials; go on with --resume")
        raise SystemExit(1) from None
    Console().print(_table(summary(trials)))
    write_rehearsal_report(out / REPORT_FILE, rehearsal, trials)
    say(f"wrote {out / REPORT_FILE}")
    wrong = [trial for trial in trials if not trial.good]
    for trial in wrong[:10]:
        say(f"not as it should be: {trial}")
    if wrong:
        raise SystemExit(1)


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
