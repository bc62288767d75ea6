"""`pinwm identify`: its options. The work is in `identify_run`."""

from pathlib import Path
from typing import Annotated

import typer


def identify(
    capture: Annotated[Path, typer.Argument(metavar="CAPTURE", help="A capture: images of an object and of a push.")],
    twin: Annotated[Path, typer.Argument(metavar="TWIN", help="Folder of the twin; surfels that are in it are used.")],
    episode: Annotated[str | None, typer.Option(help="Which push.", show_default="the first of the capture")] = None,
    free: Annotated[
        list[str] | None,
        typer.Option(help="A physical unknown to look for, instead of the default ones; repeat it."),
    ] = None,
    hold: Annotated[
        list[str] | None, typer.Option(metavar="NAME=VALUE", help="Hold an unknown at a value, or begin there.")
    ] = None,
    without: Annotated[
        list[str] | None, typer.Option(metavar="NAME", help="Switch a nuisance off, such as time_offset; repeat it.")
    ] = None,
    support: Annotated[str, typer.Option(help="How the floor carries the object: auto, corners or patch.")] = "auto",
    directions: Annotated[
        int, typer.Option(help="Directions of the friction cone; another number compiles for minutes, once.")
    ] = 32,
    starts: Annotated[int, typer.Option(help="Random starts of the optimiser, for each support.")] = 4,
    seed: Annotated[int, typer.Option(help="Of the random starts.")] = 0,
    threads: Annotated[int | None, typer.Option(help="Threads.", show_default="one on each core")] = None,
    resume: Annotated[
        bool, typer.Option("--resume", help="Go on where an interrupted run with the same input ended.")
    ] = False,
) -> None:
    """Finds mass properties, friction and restitution such that the twin reproduces the video of one push."""
    from pinwm_drake.cli.identify_run import run_identify
    from pinwm_drake.cli.identify_unknowns import choose
    from pinwm_drake.identification.options import IdentifyOptions

    names, values = choose(free, hold, without)
    options = IdentifyOptions(
        free=names,
        held=values,
        support=support,  # type: ignore[arg-type]  # IdentifyOptions refuses what it does not know
        friction_directions=directions,
        starts=starts,
        seed=seed,
        num_threads=threads,
    )
    run_identify(capture, twin, episode_name=episode, options=options, resume=resume)
