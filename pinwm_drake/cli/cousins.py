"""`pinwm cousins`: its options. The work is in `cousins_run`."""

from pathlib import Path
from typing import Annotated

import typer


def cousins(
    twin: Annotated[Path, typer.Argument(metavar="TWIN", help="Folder that `pinwm identify` wrote.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for cousins.npz and cousins.png.")],
    number: Annotated[int, typer.Option(help="How many, 1 to 200.")] = 16,
    delta: Annotated[float, typer.Option(help="Relative half-width of what is drawn, 0 or more, less than 1.")] = 0.1,
    from_intervals: Annotated[
        bool,
        typer.Option(
            "--from-intervals",
            help="Draw the physical parameters from their identified 95 % intervals; delta where there is none.",
        ),
    ] = False,
    seed: Annotated[int, typer.Option(help="Of the draws, 0 or more.")] = 0,
) -> None:
    """Draws copies of a twin with other physical parameters and colours, and shows them on a contact sheet."""
    from pinwm_drake.cli.cousins_run import run_cousins

    run_cousins(twin, out, number=number, delta=delta, from_intervals=from_intervals, seed=seed)
