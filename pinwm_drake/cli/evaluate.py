"""`pinwm evaluate`: options, a bar of the episodes, and the results in a few lines."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pinwm_drake.cli.console import progress_bar, say

if TYPE_CHECKING:
    from pinwm_drake.experiments.evaluation.run import EvaluationProgress, ProgressCallback


def evaluate(
    policy: Annotated[
        str,
        typer.Argument(
            metavar="POLICY",
            help="Folder of a policy that `pinwm train` wrote, or of a bundle that `pinwm export` wrote; "
            "or push_t, the bundle that ships; or mpc, or random.",
        ),
    ],
    out: Annotated[
        Path, typer.Option("--out", "-o", help="Folder for evaluation.json, episodes.csv, episodes.mp4, report.html.")
    ] = Path("evaluation"),
    scene: Annotated[
        str | None,
        typer.Option(
            help="A scenario that ships, a .scenario.yaml file, or the folder of a twin.",
            show_default="that of the task",
        ),
    ] = None,
    task: Annotated[
        str | None, typer.Option(help="push or flip, for mpc and random.", show_default="the scene's")
    ] = None,
    engine: Annotated[str, typer.Option(help="twin, hydroelastic or point.")] = "hydroelastic",
    episodes: Annotated[int, typer.Option(help="How many.")] = 100,
    seed: Annotated[int, typer.Option(help="Of the first episode; the next has the next.")] = 0,
    tolerance: Annotated[
        float | None, typer.Option(help="m, from the goal, for success.", show_default="the policy's, or the task's")
    ] = None,
    turn_tolerance: Annotated[
        float | None,
        typer.Option(help="rad, from the goal's, for success.", show_default="the policy's, or the task's"),
    ] = None,
    yaw: Annotated[
        float | None,
        typer.Option(help="rad, by which the object is turned at the start, at most.", show_default="the scene's"),
    ] = None,
    latency: Annotated[float, typer.Option(help="s, after which actions take effect.")] = 0.0,
    max_steps: Annotated[
        int | None, typer.Option(help="Actions in an episode.", show_default="the policy's, or the task's")
    ] = None,
    max_translation: Annotated[
        float | None,
        typer.Option(help="m, of the pusher in an action, for mpc and random.", show_default="the task's"),
    ] = None,
    model: Annotated[
        str | None,
        typer.Option(help="Twin or scenario with whose parameters mpc plans.", show_default="the scene"),
    ] = None,
    stand_in: Annotated[
        bool,
        typer.Option(
            "--stand-in",
            help="Stand in for a robot: a lump in the object and feet below it, a camera that is off, late actions, "
            "ragged masks, one lamp.",
        ),
    ] = False,
    workers: Annotated[
        int | None, typer.Option(help="Processes that share the episodes.", show_default="one on each core")
    ] = None,
    executor: Annotated[str, typer.Option(help="joblib, or ray where it is installed.")] = "joblib",
    resume: Annotated[bool, typer.Option("--resume", help="Go on where an interrupted run ended.")] = False,
) -> None:
    """Tests a policy: how often it succeeds, how soon, and what failed."""
    from pinwm_drake.experiments.evaluation import run
    from pinwm_drake.experiments.evaluation.contestant import usual_scene
    from pinwm_drake.experiments.evaluation.request import EvaluateRequest
    from pinwm_drake.report.evaluation.report import details, headline

    request = EvaluateRequest(
        policy=policy,
        scene=scene or usual_scene(policy, task),
        task=task,
        engine=engine,
        episodes=episodes,
        seed=seed,
        tolerance=tolerance,
        turn_tolerance=turn_tolerance,
        yaw=yaw,
        latency=latency,
        max_steps=max_steps,
        max_translation=max_translation,
        model=model,
        stand_in=stand_in,
    )
    done = 0
    try:
        with _shown() as show:

            def progress(stands: "EvaluationProgress") -> None:
                nonlocal done
                done = stands.done
                show(stands)

            evaluation = run.evaluate(
                request, out, workers=workers, executor=executor, resume=resume, progress=progress
            )
    except KeyboardInterrupt:
        say(f"interrupted after {done} episodes; go on with --resume")
        raise SystemExit(1) from None
    say(headline(evaluation), style="bold")
    for line in details(evaluation):
        say(f"  {line}")
    for name in (run.SUMMARY_FILE, run.TABLE_FILE, run.VIDEO_FILE, run.REPORT_FILE):
        say(f"wrote {out / name}")


@contextmanager
def _shown() -> Iterator["ProgressCallback"]:
    """Shows the progress of an evaluation: a bar of its episodes, then one of film and report."""
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
