"""`pinwm identify`: options, a bar of the search, and the values that were found in a table."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pinwm_drake.cli.align import show_align
from pinwm_drake.cli.console import say, stages_bar
from pinwm_drake.errors import ParameterError

if TYPE_CHECKING:
    from rich.table import Table

    from pinwm_drake.identification.identify import Identification
    from pinwm_drake.twin.twin import Estimate

_UNEXPLAINED = 0.01  # loss; two rolls of a mug had 0.013 and 0.019, pushes of a T-block 0.0008


def identify(
    capture: Annotated[Path, typer.Argument(metavar="CAPTURE", help="A capture: images of an object and of a push.")],
    twin: Annotated[Path, typer.Argument(metavar="TWIN", help="Folder of the twin; surfels that are in it are used.")],
    episode: Annotated[
        list[str] | None,
        typer.Option(help="Which push; repeat it for several at once.", show_default="the first of the capture"),
    ] = None,
    free: Annotated[
        list[str] | None,
        typer.Option(help="A physical unknown to look for, instead of the four below; repeat it."),
    ] = None,
    hold: Annotated[
        list[str] | None, typer.Option(metavar="NAME=VALUE", help="Hold an unknown at a value, or begin there.")
    ] = None,
    without: Annotated[
        list[str] | None, typer.Option(metavar="NAME", help="Switch a nuisance off, such as time_offset; repeat it.")
    ] = None,
    support: Annotated[
        str,
        typer.Option(
            help="How the pressure on the floor is spread: auto looks for it, patch holds it even, corners at the rim."
        ),
    ] = "auto",
    directions: Annotated[int | None, typer.Option(hidden=True, help="Accepted without effect.")] = None,
    time_step: Annotated[
        float,
        typer.Option(
            help="s, of the physics. With long steps what is round rolls too short a way; where it rolled: 0.001.",
            show_default="1/240",
        ),
    ] = 1.0 / 240.0,
    starts: Annotated[int, typer.Option(help="Random starts of the optimiser.")] = 4,
    seed: Annotated[int, typer.Option(help="Of the random starts.")] = 0,
    threads: Annotated[int | None, typer.Option(help="Threads.", show_default="one on each core")] = None,
    resume: Annotated[
        bool, typer.Option("--resume", help="Go on where an interrupted run with the same input ended.")
    ] = False,
) -> None:
    """Finds friction and horizontal moments of a twin that reproduces the video of one push, or of several.

    By default friction_floor, friction_pusher, moment_xx, moment_yy and the nuisances are looked for; mass, moment_zz
    and restitution, of which a push in the plane tells little, are held unless --free names them. The mass comes from
    fx, fy, fz in the pusher's log, where they are and neither capture.yaml nor --hold says it.
    """
    from rich.console import Console

    from pinwm_drake.documents import ROUND_CONE, warn_without_effect
    from pinwm_drake.experiments.twins import has_surfels, read_pushes, twin_from_capture
    from pinwm_drake.files import prepare_folder
    from pinwm_drake.identification.checkpoint import CHECKPOINT_FILE
    from pinwm_drake.identification.options import IdentifyOptions
    from pinwm_drake.rendering.fit_options import FitOptions
    from pinwm_drake.report.twin.score import pose_errors

    if directions is not None:
        warn_without_effect("pinwm identify", "--directions", ROUND_CONE)
    names, values = _choose(free, hold, without)
    options = IdentifyOptions(
        free=names,
        held=values,
        support=support,  # type: ignore[arg-type]  # IdentifyOptions refuses what it does not know
        time_step=time_step,
        starts=starts,
        seed=seed,
        num_threads=threads,
    )
    _, pushes = read_pushes(capture, episode or ())
    prepare_folder(twin)
    if not has_surfels(twin):
        say(f"no surfels in {twin}: aligning first")
        show_align(capture, twin, mesh=None, options=FitOptions(), resume=resume)
    if resume and not (twin / CHECKPOINT_FILE).exists():
        say(f"no {CHECKPOINT_FILE} in {twin}: starting anew")
    try:
        with stages_bar() as progress:
            result = twin_from_capture(
                capture, twin, episodes=episode or (), options=options, resume=resume, progress=progress
            )
    except KeyboardInterrupt:
        say("interrupted" + ("; go on with --resume" if (twin / CHECKPOINT_FILE).exists() else ""))
        raise SystemExit(1) from None
    Console().print(_summary(result))
    if force := result.twin.provenance.get("force"):
        say(force["note"])
    if doubt := _doubt(result.found.loss):
        say(doubt)
    for push, poses in zip(pushes, result.poses, strict=True):
        errors = None if push.object_poses is None else pose_errors(poses, push.object_poses)
        if errors is not None:
            say(f"episode {push.name}: score against object_poses.csv, which was not used: {errors.words()}")
    say(f"wrote {twin / 'twin.yaml'}; look at it with: pinwm report {twin}")


def _choose(
    free: list[str] | None, hold: list[str] | None, without: list[str] | None
) -> tuple[tuple[str, ...], dict[str, float]]:
    """Names of the free unknowns, and values of the held ones.

    Args:
        free: Names of physical unknowns to look for, instead of the default ones; nuisances are looked for as well.
        hold: Texts NAME=VALUE; such an unknown is held, or begins there where `free` names it.
        without: Names of unknowns to leave out.

    Returns:
        Names of the free unknowns, and values by name.

    Raises:
        ParameterError: A name is unknown, or a value is no number.
    """
    from pinwm_drake.identification.unknowns import DEFAULT_FREE, NUISANCES, UNKNOWNS

    values = {}
    for text in hold or []:
        name, equals, number = text.partition("=")
        try:
            values[name] = float(number)
        except ValueError:
            values[name] = math.nan
        if not equals or not math.isfinite(values[name]):
            raise ParameterError(f"--hold: got {text!r}; allowed: NAME=VALUE, as in friction_pusher=0.2")
    for option, names in (("--free", free), ("--hold", list(values)), ("--without", without)):
        for name in names or []:
            if name not in UNKNOWNS:
                raise ParameterError(f"{option}: got {name!r}; allowed: {', '.join(UNKNOWNS)}")
    left_out = {*(without or []), *(name for name in values if name not in (free or []))}
    wanted = (*free, *NUISANCES) if free else DEFAULT_FREE
    chosen = tuple(name for name in wanted if name not in left_out)
    if not chosen:
        raise ParameterError("no unknown is left; allowed: one or more free ones")
    return tuple(dict.fromkeys(chosen)), values


def _doubt(loss: float) -> str:
    """Warning of images that are explained badly, as those of a poke that rolls the object; "" for none."""
    if loss <= _UNEXPLAINED:
        return ""
    return (
        f"warning: the images are explained badly (loss {loss:.4f}; twins that predict well have 0.001 to 0.003): "
        "parameters may be farther off than their intervals say; try another --seed, another push, or, where it rolled "
        "something round, --time-step 0.001"
    )


def _summary(result: "Identification") -> "Table":
    """Table of theta and nuisances, with 95 % intervals."""
    from rich.table import Table

    twin = result.twin
    table = Table("", "value", "95 % interval", "identifiable", title=f"Twin of {twin.name}")
    for name, estimate in {**twin.theta, **twin.nuisance}.items():
        table.add_row(name, *_row(estimate))
    losses = ", ".join(f"{loss:.5f}" for loss in result.found.coarse_losses)
    table.caption = f"coarse losses {losses}; loss {result.found.loss:.5f}; {result.found.seconds:.0f} s"
    return table


def _row(estimate: "Estimate") -> tuple[str, str, str]:
    unit = "" if estimate.unit == "1" else f" {estimate.unit}"
    interval = "" if estimate.interval is None else f"{estimate.interval[0]:.4g} to {estimate.interval[1]:.4g}"
    return f"{estimate.value:.4g}{unit}", interval, "yes" if estimate.identifiable else "no"
