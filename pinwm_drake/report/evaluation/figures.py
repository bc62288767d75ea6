# SPDX-License-Identifier: MIT
"""Figures of an evaluation: success over the actions, lengths of episodes, and their starts."""

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, PercentFormatter
from scipy.stats import binomtest

from pinwm_drake.learning.evaluation import Evaluation
from pinwm_drake.report.evaluation.episode import EpisodeRecord
from pinwm_drake.report.style import GREY, new_figure, tidy

OUTCOMES = {"success": "#3b8f5a", "time limit": "#c8432f", "failure": "#7a4fa3"}
_BINS = 25
_ARROW = 10.0  # mm


def success_figure(evaluation: Evaluation, max_steps: int) -> Figure:
    """Figure of the share of episodes that had succeeded over the number of actions, with its 95 % interval."""
    steps, n = evaluation.steps(successful=True), evaluation.episodes
    at = np.arange(max_steps + 1)
    counts = [int((steps <= k).sum()) for k in at]
    low, high = np.array([binomtest(count, n).proportion_ci(method="wilson") for count in counts]).T
    figure = new_figure(8, 3.2)
    axes = figure.subplots()
    colour = OUTCOMES["success"]
    axes.fill_between(at, low, high, step="post", color=colour, alpha=0.18, linewidth=0, label="95 % interval")
    axes.step(at, np.array(counts) / n, where="post", color=colour, label="succeeded so far")
    if len(steps):
        axes.axvline(steps.mean(), color=GREY, linestyle="--", linewidth=1.2, label=f"mean, {steps.mean():.1f}")
    axes.set(xlim=(0, max_steps), ylim=(0, 1.02), xlabel="actions", ylabel="episodes")
    axes.yaxis.set_major_formatter(PercentFormatter(1.0))
    axes.legend(frameon=False, fontsize=8, loc="best")
    tidy([axes])
    return figure


def steps_figure(evaluation: Evaluation, max_steps: int) -> Figure:
    """Figure of the number of episodes over the number of their actions, by outcome."""
    figure = new_figure(8, 2.8)
    axes = figure.subplots()
    groups = {name: [one.steps for one in evaluation.results if one.outcome == name] for name in OUTCOMES}
    groups = {name: steps for name, steps in groups.items() if steps}
    width = -(-max_steps // _BINS)
    edges = np.arange(0.5, max_steps + width + 0.5, width).tolist()
    colours = [OUTCOMES[name] for name in groups]
    labels = [f"{name}, {len(steps)}" for name, steps in groups.items()]
    axes.hist(list(groups.values()), edges, stacked=True, color=colours, label=labels)
    axes.set(xlim=(0, edges[-1]), xlabel="actions", ylabel="episodes")
    axes.yaxis.set_major_locator(MaxNLocator(integer=True))
    axes.legend(frameon=False, fontsize=8, loc="best")
    tidy([axes])
    return figure


def start_figure(records: Sequence[EpisodeRecord], q_WO: tuple[float, float, float, float]) -> Figure:
    """Figure of the object's starts, as arrows along its x axis, and of the number of actions over the start yaw.

    The object lies in the orientation q_WO (4,) wxyz at yaw 0.
    """
    figure = new_figure(10, 4.4)
    place, turn = figure.subplots(1, 2)
    starts = np.array([record.start(q_WO) for record in records])
    steps = np.array([record.result.steps for record in records])
    outcomes = np.array([record.result.outcome for record in records])
    for name, colour in OUTCOMES.items():
        x, y, yaw = starts[outcomes == name].T
        if not len(x):
            continue
        arrows = (1e3 * x, 1e3 * y, _ARROW * np.cos(yaw), _ARROW * np.sin(yaw))
        place.quiver(*arrows, color=colour, angles="xy", scale_units="xy", scale=1, width=0.004)
        place.plot(1e3 * x, 1e3 * y, "o", color=colour, markersize=4)
        turn.plot(np.degrees(yaw), steps[outcomes == name], "o", color=colour, markersize=4, label=name)
    place.set(xlabel="x [mm]", ylabel="y [mm]", aspect="equal")
    place.margins(0.12)
    turn.set(xlabel="yaw at the start [°]", ylabel="actions", ylim=(0, None))
    turn.legend(frameon=False, fontsize=8, loc="lower left", bbox_to_anchor=(0.0, 1.0), ncol=3)
    tidy([place, turn])
    return figure
