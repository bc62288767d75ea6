"""`pinwm rehearse`: options, a bar, and the table of faults."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.table import Table

from pinwm_drake.cli.console import progress_bar, say

if TYPE_CHECKING:
    from pinwm_drake.experiments.rehearsal.run import Trial


def rehearse(
    bundle: Annotated[
        str, typer.Argument(metavar="BUNDLE", help="Folder that `pinwm export` wrote, or the name of one that ships.")
    ],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder of the results, new or empty.")] = Path(
        "out/rehearsal"
    ),
    scene: Annotated[
        str | None,
        typer.Option(
            help="A scenario that ships, a .scenario.yaml file, or the folder of a twin.",
            show_default="that of the bundle's task and object",
        ),
    ] = None,
    goal: Annotated[
        tuple[float, float, float] | None,
        typer.Option(help="x [m], y [m] and yaw [rad] of the object, for a bundle that is told its goal."),
    ] = None,
    faults: Annotated[bool, typer.Option("--faults", help="Bring about faults at random moments.")] = False,
    moments: Annotated[int, typer.Option(help="Random moments of each kind of fault.")] = 5,
    kind: Annotated[
        list[str] | None, typer.Option(help="A kind of fault; may be given again.", show_default="all")
    ] = None,
    minutes: Annotated[float, typer.Option(help="Of normal work, at least.")] = 0.0,
    episodes: Annotated[
        int | None, typer.Option(help="Of normal work, at least.", show_default="none with --faults, else 10")
    ] = None,
    latency: Annotated[float, typer.Option(help="s, between an image's exposure and its arrival.")] = 0.0,
    port: Annotated[int, typer.Option(help="Of LCM on this machine; two rehearsals at once need two.")] = 7690,
    seed: Annotated[int, typer.Option(help="Of moments and starts.")] = 0,
    resume: Annotated[bool, typer.Option("--resume", help="Go on where an interrupted rehearsal ended.")] = False,
) -> None:
    """Rehearses a bundle with a simulated arm over LCM in real time: normal work, or faults that have to stop it."""
    from pinwm_drake.experiments.rehearsal.report import REPORT_FILE, write_rehearsal_report
    from pinwm_drake.experiments.rehearsal.run import RehearseRequest, shortfall, summary
    from pinwm_drake.experiments.rehearsal.run import rehearse as run

    normal = 0 if faults or minutes else 10
    request = RehearseRequest(
        bundle=bundle,
        scene=scene,
        goal=goal,
        moments=moments if faults else 0,
        kinds=tuple(kind or ()),
        minutes=minutes,
        episodes=normal if episodes is None else episodes,
        latency=latency,
        port=port,
        seed=seed,
    )
    short = shortfall(request)
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

            trials = run(request, out, resume=resume, report=report)
    except KeyboardInterrupt:
        say(f"interrupted after {done} trials; go on with --resume")
        raise SystemExit(1) from None
    Console().print(_table(summary(trials)))
    write_rehearsal_report(out / REPORT_FILE, request, trials)
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
