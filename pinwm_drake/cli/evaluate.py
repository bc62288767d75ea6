"""`pinwm evaluate`: its options. The work is in `evaluate_run`."""

from pathlib import Path
from typing import Annotated

import typer


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
        str, typer.Option(help="A scenario that ships, a .scenario.yaml file, or the folder of a twin.")
    ] = "push_t",
    engine: Annotated[str, typer.Option(help="twin, hydroelastic or point.")] = "hydroelastic",
    episodes: Annotated[int, typer.Option(help="How many.")] = 100,
    seed: Annotated[int, typer.Option(help="Of the first episode; the next has the next.")] = 0,
    tolerance: Annotated[
        float | None, typer.Option(help="m, from the goal, for success.", show_default="the policy's, or 0.02")
    ] = None,
    turn_tolerance: Annotated[
        float | None, typer.Option(help="rad, from the goal's, for success.", show_default="the policy's, or 0.2")
    ] = None,
    yaw: Annotated[
        float | None,
        typer.Option(help="rad, by which the object is turned at the start, at most.", show_default="the scene's"),
    ] = None,
    max_steps: Annotated[
        int | None, typer.Option(help="Actions in an episode.", show_default="the policy's, or 100")
    ] = None,
    max_translation: Annotated[
        float | None,
        typer.Option(help="m, of the pusher in an action, for mpc and random.", show_default="0.02"),
    ] = None,
    model: Annotated[
        str | None,
        typer.Option(help="Twin or scenario with whose parameters mpc plans.", show_default="the scene"),
    ] = None,
    workers: Annotated[
        int | None, typer.Option(help="Processes that share the episodes.", show_default="one on each core")
    ] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Go on where an interrupted run ended.")] = False,
) -> None:
    """Tests a policy: how often it succeeds, how soon, and what failed."""
    from pinwm_drake.cli.evaluate_run import run_evaluate
    from pinwm_drake.experiments.evaluation.request import EvaluateRequest

    request = EvaluateRequest(
        policy=policy,
        scene=scene,
        engine=engine,
        episodes=episodes,
        seed=seed,
        tolerance=tolerance,
        turn_tolerance=turn_tolerance,
        yaw=yaw,
        max_steps=max_steps,
        max_translation=max_translation,
        model=model,
    )
    run_evaluate(request, out, workers=workers, resume=resume)
