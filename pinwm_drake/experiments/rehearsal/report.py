"""Report of a rehearsal: one page that loads nothing from anywhere."""

from dataclasses import asdict
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from pinwm_drake.experiments.rehearsal.faults import kind_of
from pinwm_drake.experiments.rehearsal.run import RehearseRequest, Trial, summary
from pinwm_drake.files import replacing
from pinwm_drake.report.embed import figure_uri
from pinwm_drake.report.page import figure, fill_template, paragraph, section, table, text, tree

REPORT_FILE = "report.html"
_COLUMNS = (
    *(("fault", "key"), ("what happens", "wide"), ("trials", "number"), ("stopped in time", "number")),
    *(("median [s]", "number"), ("longest [s]", "number"), ("allowed [s]", "number"), ("reasons told", "wide")),
)


def write_rehearsal_report(path: Path, request: RehearseRequest, trials: list[Trial]) -> None:
    """Writes the report of a rehearsal.

    Args:
        path: Page to write, in HTML.
        request: The rehearsal.
        trials: Its trials, 1 or more.
    """
    found = summary(trials)
    good = sum(trial.good for trial in trials)
    rows = [
        [
            text(name),
            text(kind_of(name).words),
            text(one["trials"]),
            text(one["good"]),
            *(f"{one[key]:.3f}" for key in ("median_to_zero", "longest_to_zero", "allowed")),
            text("; ".join(one["reasons"])),
        ]
        for name, one in found["faults"].items()
    ]
    faults = section(
        "Faults",
        paragraph(
            "Seconds from the fault to the last command that moves the robot. Allowed is the time after which it can "
            "be known, and one action."
        ),
        figure(
            figure_uri(_times_figure(trials)), "Seconds from each fault to zero on the wire; a cross where it is late"
        ),
        table(_COLUMNS, rows),
    )
    wrong = [trial for trial in trials if not trial.good]
    sections = [
        faults if rows else "",
        section("Normal work", tree(found["normal"])) if "normal" in found else "",
        section("Not as they should be", *(tree(asdict(trial)) for trial in wrong[:50])),
        section("Request", tree(asdict(request))),
    ]
    parts = {
        "title": text(f"Rehearsal of {request.bundle}"),
        "about": text(f"With a simulated arm over LCM, in real time, in the scene {request.scene or 'of the bundle'}"),
        "notices": paragraph(f"{good} of {len(trials)} trials as they should be", "headline"),
        "body": "\n".join(part for part in sections if part),
    }
    with replacing(path) as temporary:
        temporary.write_text(fill_template(parts), encoding="utf-8")


def _times_figure(trials: list[Trial]) -> Figure:
    """Seconds from fault to zero, a row for each kind."""
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
