"""`pinwm crosscheck`: its options. The work is in `crosscheck_run`."""

from pathlib import Path
from typing import Annotated

import typer


def crosscheck(
    twin: Annotated[
        str, typer.Argument(metavar="TWIN", help="Folder that `pinwm identify` wrote, or a .scenario.yaml file.")
    ],
    more: Annotated[
        list[str] | None, typer.Argument(metavar="ENGINE", help="Further engines: --engine hydroelastic point.")
    ] = None,
    engine: Annotated[
        list[str] | None,
        typer.Option(help="Drake's contact model to compare with.", show_default="hydroelastic and point"),
    ] = None,
    pushes: Annotated[int, typer.Option(help="How many random pushes.")] = 20,
    seed: Annotated[int, typer.Option(help="Of the pushes.")] = 0,
    truth: Annotated[
        Path | None,
        typer.Option(
            help="ground_truth.yaml of a simulated capture: the plants have the true parameters, which checks "
            "the identified ones.",
            show_default="the plants have those of the twin, which checks the physics",
        ),
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="Folder for crosscheck.csv and crosscheck.png.")
    ] = None,
    threshold_translation: Annotated[
        float, typer.Option(help="In m, for the median difference of the object's place after rest.")
    ] = 0.003,
    threshold_rotation: Annotated[float, typer.Option(help="In degrees, likewise of its orientation.")] = 2.0,
    processes: Annotated[
        int | None, typer.Option(help="That share the pushes.", show_default="2, or 1 on one core")
    ] = None,
) -> None:
    """Sends the same pushes through a twin and Drake's own contact; exits with 0 for PASS and with 1 for FAIL."""
    from pinwm_drake.cli.crosscheck_run import run_crosscheck

    engines = (*(engine or ()), *(more or ()))
    run_crosscheck(
        twin,
        truth,
        out,
        engines=engines,
        pushes=pushes,
        seed=seed,
        threshold_translation=threshold_translation,
        threshold_rotation=threshold_rotation,
        processes=processes,
    )
