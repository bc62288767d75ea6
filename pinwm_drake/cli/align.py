"""`pinwm align`: its options. The work is in `align_run`."""

from pathlib import Path
from typing import Annotated

import typer


def align(
    source: Annotated[
        Path,
        typer.Argument(
            metavar="IMAGES_OR_CAPTURE", help="A capture (capture.yaml), or images with a nerfstudio transforms.json."
        ),
    ],
    out: Annotated[
        Path,
        typer.Argument(metavar="OUT", help="Folder for surfels.ply, align.json, align.png, turntable.mp4, view.html."),
    ],
    mesh: Annotated[Path | None, typer.Option(help="The object's mesh, in metres; a capture names its own.")] = None,
    iterations: Annotated[int, typer.Option(help="Steps of the optimiser, one view each.")] = 4000,
    max_surfels: Annotated[int, typer.Option(help="How many surfels there may be in the end.")] = 5000,
    sh_degree: Annotated[int, typer.Option(help="Degree of the spherical harmonics, 0 to 3.")] = 3,
    held_out: Annotated[int, typer.Option(help="Keep every so many-th view for testing only; 0 keeps none.")] = 4,
    seed: Annotated[int, typer.Option(help="Of the first surfels and of the order of views.")] = 0,
    threads: Annotated[int | None, typer.Option(help="Threads.", show_default="one on each core")] = None,
    resume: Annotated[
        bool, typer.Option("--resume", help="Go on where an interrupted run with the same input ended.")
    ] = False,
) -> None:
    """Fits surfels to posed images of an object: its appearance, in the frame of its mesh."""
    from pinwm_drake.cli.align_run import run_align
    from pinwm_drake.rendering.fit_options import FitOptions

    options = FitOptions(
        iterations=iterations,
        max_surfels=max_surfels,
        sh_degree=sh_degree,
        held_out=held_out,
        seed=seed,
        num_threads=threads,
    )
    run_align(source, out, mesh_path=mesh, options=options, resume=resume)
