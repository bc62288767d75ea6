# SPDX-License-Identifier: MIT
"""`pinwm align`: a bar of the fit, and its quality in a table."""

import math
from typing import TYPE_CHECKING

from pinwm_drake.cli.console import say, stages_bar
from pinwm_drake.experiments.requests.identify import AlignRequest

if TYPE_CHECKING:
    from rich.table import Table

    from pinwm_drake.rendering.fitting import FitResult


def align(request: AlignRequest) -> None:
    """Fit surfels to posed images: the appearance of an object."""
    from rich.console import Console

    from pinwm_drake.experiments.alignment import align as run
    from pinwm_drake.rendering.fitting import CHECKPOINT_FILE
    from pinwm_drake.report.live.page import PAGE_FILE
    from pinwm_drake.report.surfels.fit_results import ALIGN_FILE, FILES, read_registration
    from pinwm_drake.spatial.rotations import quaternion_log

    out = request.out
    if request.resume and not (out / CHECKPOINT_FILE).exists():
        say(f"no {CHECKPOINT_FILE} in {out}: starting anew")
    if request.view:
        say(f"open {out / PAGE_FILE} in a browser: it shows the run while it goes on")
    iteration = 0
    try:
        with stages_bar() as show:

            def progress(stage: str, done: float, figures: str) -> None:
                nonlocal iteration
                iteration = round(done * request.fit.iterations) if stage == "fitting" else iteration
                show(stage, done, figures)

            result = run(
                request.source,
                out,
                mesh_path=request.mesh,
                options=request.fit,
                resume=request.resume,
                view=request.view,
                progress=progress,
            )
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
