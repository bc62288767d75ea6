# SPDX-License-Identifier: MIT
"""Figures of an identification's history."""

import math
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pinwm_drake.identification.history import History
from pinwm_drake.report.style import GREY, TRUTH, TWIN, new_figure, plain_log, start_colour, tidy
from pinwm_drake.twin.twin import THETA, Estimate

_MOST_STAGES = 12
_COLUMNS = 3


def loss_figure(history: History) -> Figure:
    """Figure of the loss of each random start over its iterations; the beginnings of the stages are marked."""
    figure = new_figure(9, 3.4)
    axes = figure.subplots()
    for number, rows in history.starts():
        axes.plot(history.iteration[rows], history.loss[rows], **_line(history, number, rows), label=f"start {number}")
    finite = history.loss[np.isfinite(history.loss)]
    if len(finite) and finite.min() > 0:
        plain_log(axes)
    _mark_stages(axes, history, named=True)
    axes.set(xlabel="iteration", ylabel="loss")
    if 0 < len(history.starts()) <= 12:
        axes.legend(frameon=False, fontsize=8, ncol=4)
    tidy([axes])
    return figure


def theta_figure(history: History, final: dict[str, Estimate], truth: dict[str, float]) -> Figure:
    """Figure of each fitted parameter over the iterations, with the twin's value, its interval, and the truth.

    Args:
        history: History of the optimiser.
        final: The twin's estimates, by name.
        truth: True values of the parameters, by name, where known.
    """
    rows = math.ceil(len(history.names) / _COLUMNS)
    figure = new_figure(9, 0.3 + 2.1 * rows)
    panels = figure.subplots(rows, min(_COLUMNS, len(history.names)), squeeze=False, sharex=True).ravel()
    for axes, (column, name) in zip(panels, enumerate(history.names), strict=False):
        for number, at in history.starts():
            axes.plot(history.iteration[at], history.theta[at, column], **_line(history, number, at))
        _draw_result(axes, final.get(name), truth.get(name), history.theta[:, column])
        _mark_stages(axes, history, named=False)
        unit = final[name].unit if name in final else THETA.get(name, "")
        axes.set_title(name + (f" [{unit}]" if unit not in ("", "1") else ""), fontsize=9)
        axes.tick_params(labelsize=8, labelbottom=True)
    for axes in panels[len(history.names) :]:
        axes.set_visible(False)
    figure.supxlabel("iteration", fontsize=9)
    tidy(panels)
    return figure


def _line(history: History, number: int, rows: np.ndarray) -> dict[str, Any]:
    marker = "o" if len(rows) == 1 else ""
    return {"color": start_colour(number), "linewidth": 1.3, "alpha": 0.85, "marker": marker, "markersize": 4}


def _draw_result(axes: Axes, final: Estimate | None, truth: float | None, values: np.ndarray) -> None:
    """Draws the twin's value and interval, as far as it is within sight, and the truth."""
    if final is not None:
        if final.interval is not None and final.identifiable and np.all(np.isfinite(final.interval)):
            axes.axhspan(*final.interval, color=TWIN, alpha=0.12, linewidth=0)
        axes.axhline(final.value, color=TWIN, linewidth=0.9, linestyle="-.")
    if truth is not None:
        axes.axhline(truth, color=TRUTH, linewidth=1.2, linestyle=":")
    shown = [value for value in (final.value if final else None, truth) if value is not None]
    finite = np.concatenate([values[np.isfinite(values)], shown])
    if len(finite):
        low, high = finite.min(), finite.max()
        margin = 0.08 * (high - low) or 0.05 * max(abs(low), 1e-6)
        axes.set_ylim(low - margin, high + margin)


def _mark_stages(axes: Axes, history: History, *, named: bool) -> None:
    stages = history.stage_begins()
    if not 1 < len(stages) <= _MOST_STAGES:
        return
    for at, name in stages:
        axes.axvline(at, color=GREY, linewidth=0.8, linestyle=":")
        if named:
            place: dict[str, Any] = {"xycoords": ("data", "axes fraction"), "textcoords": "offset points"}
            axes.annotate(f"stage {name}", (at, 1.0), (2, 2), fontsize=7, color=GREY, **place)
