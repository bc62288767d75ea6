# SPDX-License-Identifier: MIT
"""Report of a rehearsal: one page that loads nothing from anywhere."""

from dataclasses import asdict
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from pinwm_drake.experiments.rehearsal.faults import kind_of
from pinwm_drake.experiments.rehearsal.run import Trial, summary
from pinwm_drake.experiments.requests.control import RehearseRequest
from pinwm_drake.report.page import write_page

REPORT_FILE = "report.html"


def write_rehearsal_report(path: Path, request: RehearseRequest, trials: list[Trial], where: str = "") -> None:
    """Write the report of a rehearsal.

    Args:
        path: Page to write, in HTML.
        request: The rehearsal.
        trials: Its trials, 1 or more.
        where: Object, scene and engine in words; "" where they are not known.
    """
    write_page(
        path,
        "experiments/rehearsal/report.html",
        request=request,
        where=where,
        trials=len(trials),
        wrong=[trial for trial in trials if not trial.good],
        found=summary(trials),
        times=_times_figure(trials),
        kind_of=kind_of,
        asdict=asdict,
    )


def _times_figure(trials: list[Trial]) -> Figure:
    kinds = list(dict.fromkeys(trial.kind for trial in trials if trial.kind))
    drawn = Figure(figsize=(8, 0.6 + 0.24 * max(len(kinds), 1)), layout="constrained")
    axes = drawn.subplots()
    for row, kind in enumerate(kinds):
        some = [trial for trial in trials if trial.kind == kind]
        spread = row + np.linspace(-0.25, 0.25, len(some))
        for good, marker, colour in ((True, ".", "C0"), (False, "x", "C3")):
            shown = [k for k, trial in enumerate(some) if trial.good == good]
            axes.plot([some[k].to_zero for k in shown], spread[shown], marker, color=colour, markersize=4)
        axes.plot([some[0].allowed] * 2, [row - 0.4, row + 0.4], color="grey")
    axes.set(yticks=range(len(kinds)), yticklabels=kinds, xlabel="from fault to zero [s]; grey: allowed")
    axes.set_ylim(max(len(kinds), 1) - 0.5, -0.5)
    return drawn
