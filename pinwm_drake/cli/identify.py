# SPDX-License-Identifier: MIT
"""`pinwm identify`: bars, and the values that were found in a table."""

import math
from typing import TYPE_CHECKING, Any

from pinwm_drake.cli.console import say, stages_bar
from pinwm_drake.experiments.requests.identify import IdentifyRequest

if TYPE_CHECKING:
    from rich.table import Table

    from pinwm_drake.identification.identify import Identification


def identify(request: IdentifyRequest) -> None:
    """Find friction and moments of a twin from videos of pushes.

    By default friction_floor, friction_pusher, moment_xx, moment_yy and the nuisances are looked for; mass, moment_zz
    and restitution, of which a push in the plane tells little, are held unless --free names them. The mass comes from
    fx, fy, fz in the pusher's log, where they are and neither capture.yaml nor --hold says it.
    """
    from rich.console import Console

    from pinwm_drake.documents import ROUND_CONE, warn_without_effect
    from pinwm_drake.experiments.twins import has_surfels, identify, read_pushes, task_doubts
    from pinwm_drake.geometry.primitive import acting_words
    from pinwm_drake.identification.checkpoint import CHECKPOINT_FILE
    from pinwm_drake.identification.time_step import way_in_a_step
    from pinwm_drake.rendering.fitting import CHECKPOINT_FILE as FIT_CHECKPOINT
    from pinwm_drake.report.live.page import PAGE_FILE
    from pinwm_drake.report.twin.score import pose_errors
    from pinwm_drake.twin.words import doubt_words

    if request.directions is not None:
        warn_without_effect("pinwm identify", "--directions", ROUND_CONE)
    options, twin = request.options(), request.twin
    _, pushes = read_pushes(request.capture, request.episodes)
    if request.poses is None and not has_surfels(twin):
        say(f"no surfels in {twin}: aligning first")
    if request.resume and not (twin / CHECKPOINT_FILE).exists():
        say(f"no {CHECKPOINT_FILE} in {twin}: starting anew")
    if request.view:
        say(f"open {twin / PAGE_FILE} in a browser: it shows the run while it goes on")
    try:
        with stages_bar() as progress:
            result = identify(
                request.capture,
                twin,
                episodes=request.episodes,
                options=options,
                poses=request.poses,
                resume=request.resume,
                view=request.view,
                progress=progress,
            )
    except KeyboardInterrupt:
        kept = (twin / (CHECKPOINT_FILE if has_surfels(twin) else FIT_CHECKPOINT)).exists()
        say("interrupted" + ("; go on with --resume" if kept else ""))
        raise SystemExit(1) from None
    Console().print(_summary(result))
    say(f"the object acts as {acting_words(result.twin.acts_as)}")
    if force := result.twin.provenance.get("force"):
        say(force["note"])
    step = result.twin.time_step
    say(f"time step {1e3 * step:.3g} ms: the pusher moves by {1e3 * way_in_a_step(pushes, step):.1f} mm in it at most")
    if measured := result.twin.provenance.get("poses"):
        say(_noise(measured))
    elif doubt := doubt_words(result.found.loss):
        say(f"warning: {doubt}")
    for doubt in task_doubts(result.twin, pushes):
        say(f"warning: {doubt}")
    if frame := result.twin.provenance.get("frame"):
        say(frame["note"])
    for push, poses in zip(pushes, result.poses, strict=True):
        errors = None if push.object_poses is None else pose_errors(poses, push.object_poses)
        if errors is not None:
            used = "which was not used" if request.poses is None else "whether used or not"
            say(f"episode {push.name}: score against object_poses.csv, {used}: {errors.words()}")
    say(f"wrote {twin / 'twin.yaml'}; look at it with: pinwm report {twin}")


def _noise(measured: dict[str, Any]) -> str:
    """One line on measured poses: their noise, and the rows that were left out."""
    x, y, _ = measured["noise"]["position"]
    words = (
        f"noise of the measured poses: {500.0 * (x + y):.2f} mm, {math.degrees(measured['noise']['rotation'][2]):.2f}°"
    )
    for name, lines in measured["wrong_lines"].items():
        shown = ", ".join(map(str, lines[:5])) + (", ..." if len(lines) > 5 else "")
        words += f"; {name}: lines {shown} are far from their neighbours and left out"
    if number := measured["rows_outside_log"]:
        words += f"; {number} rows outside of the pusher's log left out"
    return words


def _summary(result: "Identification") -> "Table":
    """Table of theta and nuisances, with 95 % intervals."""
    from rich.table import Table

    from pinwm_drake.twin.words import IDENTIFIABLE, estimate_words

    twin = result.twin
    table = Table("", title=f"Twin of {twin.name}")
    for heading in ("value", "95 % interval"):
        table.add_column(heading, justify="right")
    for heading in ("unit", "identifiable"):
        table.add_column(heading)
    for group in (twin.theta, twin.nuisance):
        for name, estimate in group.items():
            words = estimate_words(estimate)
            table.add_row(name, words.value, words.interval, words.unit, "yes" if estimate.identifiable else "no")
        table.add_section()
    losses = ", ".join(f"{loss:.5f}" for loss in result.found.coarse_losses)
    table.caption = (
        f"{IDENTIFIABLE}\n"
        f"losses of the random starts {losses}; at the end {result.found.loss:.5f}; {result.found.seconds:.0f} s"
    )
    return table
