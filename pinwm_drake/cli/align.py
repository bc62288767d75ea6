"""`pinwm align`: options, a bar of the fit, and its quality in a table."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pinwm_drake.cli.console import say, stages_bar

if TYPE_CHECKING:
    from rich.table import Table

    from pinwm_drake.rendering.fit_options import FitOptions
    from pinwm_drake.rendering.fitting import FitResult


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
    iterations: Annotated[int, typer.Option(help="Steps of the optimiser, one view each.")] = 2500,
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
    from pinwm_drake.rendering.fit_options import FitOptions

    options = FitOptions(
        iterations=iterations,
        max_surfels=max_surfels,
        sh_degree=sh_degree,
        held_out=held_out,
        seed=seed,
        num_threads=threads,
    )
    show_align(source, out, mesh=mesh, options=options, resume=resume)


def show_align(source: Path, out: Path, *, mesh: Path | None, options: "FitOptions", resume: bool) -> None:
    """Fits surfels with a bar, and prints the result.

    Args:
        source: A capture, or images with poses.
        out: Folder of the results.
        mesh: The object's mesh; None for that of the capture.
        options: Options of the fit.
        resume: Flag: the fit goes on from a checkpoint, where there is one.

    Raises:
        PinwmError: An input was refused, or a file cannot be written.
        SystemExit: With 1, when the user interrupts the fit (Ctrl-C).
    """
    from rich.console import Console

    from pinwm_drake.experiments.alignment import align
    from pinwm_drake.rendering.fitting import CHECKPOINT_FILE
    from pinwm_drake.report.surfels.fit_results import ALIGN_FILE, FILES, read_registration
    from pinwm_drake.spatial.rotations import quaternion_log

    if resume and not (out / CHECKPOINT_FILE).exists():
        say(f"no {CHECKPOINT_FILE} in {out}: starting anew")
    iteration = 0
    try:
        with stages_bar() as show:

            def progress(stage: str, done: float, figures: str) -> None:
                nonlocal iteration
                iteration = round(done * options.iterations) if stage == "fitting" else iteration
                show(stage, done, figures)

            result = align(source, out, mesh_path=mesh, options=options, resume=resume, progress=progress)
    except KeyboardInterrupt:
        kept = "; go on with --resume" if (out / CHECKPOINT_FILE).exists() else ""
        say(f"interrupted after iteration {iteration}{kept}")
        raise SystemExit(1) from None
    Console().print(_summary(result))
    shift = read_registration(out / ALIGN_FILE)
    place, turn = 1e3 * float(shift.p.norm()), math.degrees(float(quaternion_log(shift.q).norm()))
    if place > 0.0 or turn > 0.0:
        say(f"the static views show the object {place:.1f} mm and {turn:.1f}° away from its pose in the capture")
    for name in FILES:
        say(f"wrote {out / name}")


def _summary(result: "FitResult") -> "Table":
    """Table of the quality of fitted and held-out views, PSNR in dB."""
    from rich.table import Table

    table = Table("", "views", "mean PSNR", "lowest", "highest", title="Surfels fitted to images")
    for name, values in (("fitted", result.psnr_train), ("held out", result.psnr_test)):
        if values:
            decibels = list(values.values())
            mean = sum(decibels) / len(decibels)
            figures = (f"{value:.2f} dB" for value in (mean, min(decibels), max(decibels)))
            table.add_row(name, str(len(values)), *figures)
    table.caption = f"{result.surfels.num_surfels:,} surfels in {result.seconds:.0f} s"
    return table
