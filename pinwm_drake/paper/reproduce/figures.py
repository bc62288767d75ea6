# SPDX-License-Identifier: MIT
"""Figures of the tables, from the results of their cells; what is missing is named in them."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeVar

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter

from pinwm_drake.paper.reproduce.cell import Cell
from pinwm_drake.paper.reproduce.policies import EvaluationCell
from pinwm_drake.paper.reproduce.predictions import ImaginedStepCell, OneStepCell, SeenOutcomesCell
from pinwm_drake.paper.reproduce.request import ReproduceRequest
from pinwm_drake.paper.reproduce.systems import PIN_WM, task_scene
from pinwm_drake.paper.reproduce.tables import BESIDE, MISSING, Results, Table, unknown
from pinwm_drake.paper.reproduce.twins import IdentifiedCell, NoisyCaptureCell
from pinwm_drake.report.style import GREY, PUSHER, TRUTH, TWIN, new_figure, start_colour, tidy
from pinwm_drake.twin.twin import THETA

Made = TypeVar("Made", bound=Cell)
Key = TypeVar("Key")
Result = Mapping[str, Any]
Predicted = OneStepCell | ImaginedStepCell | SeenOutcomesCell
_PARTS = (("translation", 1e3, "translation [mm]"), ("rotation", 1.0, "rotation [rad]"))
_ROW, _FRAME = 0.28, 0.55  # inches: a row's height, and that of a panel's title and axis
_SPREAD = 0.5  # of a row, over which seeds are spread


def table_figures(table: Table, request: ReproduceRequest, results: Results) -> dict[str, Figure]:
    """Figures of a table, by the stems of their files; none where nothing is made.

    Evaluations are drawn as rates and actions, predictions as errors, twins as parameters beside the true ones.
    """
    done = {cell: None if (one := results.get(cell)) is None else one["result"] for cell in table.cells(request)}
    evaluations = _of(EvaluationCell, done)
    steps: dict[Predicted, Result | None] = {
        **_of(OneStepCell, done),
        **_of(ImaginedStepCell, done),
        **_of(SeenOutcomesCell, done),
    }
    twins = _of(IdentifiedCell, done)
    figures: dict[str, Figure] = {}
    if any(evaluations.values()):
        figures[table.name] = success_figure(evaluations)
    resting = {cell: steps.pop(cell) for cell in list(steps) if cell.outcomes.rest}
    if any(steps.values()):
        noisy = any(_mesh(cell)[0] > 0.0 for cell in steps)
        figures[table.name] = noise_figure(steps) if noisy else error_figure(steps)
        curves = {_path(cell): found["curve"] for cell, found in steps.items() if found and found.get("curve")}
        if curves and not noisy:
            figures[f"{table.name}-curve"] = curve_figure(curves)
    if any(resting.values()):
        figures[f"{table.name}-at-rest"] = error_figure(resting)
    if any(twins.values()):
        figures[table.name] = parameter_figure(twins)
    return figures


def curve_figure(curves: Mapping[str, Sequence[Mapping[str, Any]]]) -> Figure:
    """Figure of mean errors over the iterations of identifications."""
    figure, panels = _pair()
    for axes, (part, scale, _) in zip(panels, _PARTS, strict=True):
        for name, points in curves.items():
            means = [scale * point[part]["mean"] for point in points]
            axes.plot([point["iteration"] for point in points], means, marker=".", label=name)
        axes.set(xlabel="iteration", yscale="log")
    panels[0].legend(frameon=False, fontsize=8)
    tidy(panels)
    return figure


def success_figure(results: Mapping[EvaluationCell, Result | None]) -> Figure:
    """Figure of success with Wilson's 95 % intervals, and of the mean number of actions of a success.

    A bar is the mean of a system's seeds, and a point a seed.
    """
    figure, panels = _rows_figure(results, lambda cell: cell.task, lambda cell: cell.system)
    for task, (left, right), rows in panels:
        for at, found in enumerate(rows.values()):
            rates = [one["success_rate"] for one in found]
            left.barh(at, np.mean(rates) if rates else 0.0, height=0.75, color=PUSHER, alpha=0.3)
            for y, rate, one in zip(_spread(at, found), rates, found, strict=True):
                low, high = one["interval_95"]
                reach = [[max(0.0, rate - low)], [max(0.0, high - rate)]]
                left.errorbar(rate, y, xerr=reach, fmt="o", color=PUSHER, markersize=3, linewidth=1)
            actions = [steps for one in found if (steps := one["steps"]["successes"]["mean"]) is not None]
            right.barh(at, np.mean(actions) if actions else 0.0, height=0.75, color=PUSHER, alpha=0.3)
            right.plot(actions, _spread(at, actions), "o", color=PUSHER, markersize=3)
            if found and not actions:
                _note(right, at, "no success")
        left.set_title(f"{task}: success", fontsize=9)
        left.set_xlim(0.0, 1.02)
        left.xaxis.set_major_formatter(PercentFormatter(1.0))
        right.set_title(f"{task}: actions of a success", fontsize=9)
        right.set_xlim(left=0.0)
    return figure


def error_figure(results: Mapping[Predicted, Result | None]) -> Figure:
    """Figure of errors after one action: the mean of each seed, and a line from the median to the 95th percentile."""
    figure, panels = _rows_figure(results, lambda cell: cell.outcomes.task, lambda cell: cell.origin)
    for task, pair, rows in panels:
        for axes, (part, scale, title) in zip(pair, _PARTS, strict=True):
            for at, found in enumerate(rows.values()):
                for y, one in zip(_spread(at, found), found, strict=True):
                    middle, mean, high = (scale * one[part][name] for name in ("median", "mean", "high"))
                    axes.plot([middle, high], [y, y], color=TWIN, linewidth=1)
                    axes.plot(mean, y, "o", color=TWIN, markersize=4)
            axes.set_title(f"{task}: {title}", fontsize=9)
            axes.set_xlim(left=0.0)
    return figure


def noise_figure(results: Mapping[Predicted, Result | None]) -> Figure:
    """Figure of mean errors after one action over the noise of the mesh: a point a seed, the line their mean."""
    figure, panels = _pair()
    for number, (known, mine) in enumerate(_grouped(results, lambda cell: _mesh(cell)[1]).items()):
        shares = {100.0 * share: _done(found) for share, found in _grouped(mine, lambda cell: _mesh(cell)[0]).items()}
        missing = ", ".join(f"{share:g}" for share, found in shares.items() if not found)
        label = f"{known} ({MISSING}: {missing} %)" if missing else known
        for axes, (part, scale, _) in zip(panels, _PARTS, strict=True):
            means = {share: [scale * one[part]["mean"] for one in found] for share, found in shares.items() if found}
            colour = start_colour(number)
            axes.plot(list(means), [np.mean(each) for each in means.values()], color=colour, label=label)
            for share, each in means.items():
                axes.plot([share] * len(each), each, "o", color=colour, markersize=4)
    for axes in panels:
        axes.set_xlabel("sigma of the vertices by the mesh's diagonal [%]")
        axes.set_ylim(bottom=0.0)
    panels[0].legend(frameon=False, fontsize=8)
    tidy(panels)
    return figure


def parameter_figure(results: Mapping[IdentifiedCell, Result | None]) -> Figure:
    """Figure of identified parameters with their 95 % intervals, by system; hollow where the video does not tell.

    The dotted line is the true value, and a point is a seed.
    """
    tasks = _grouped(results, lambda cell: cell.surfels.capture.task)
    panels = list(dict.fromkeys(_panel(cell) for cell in results))
    figure = new_figure(2.9 * len(panels), 2.6 * len(tasks))
    grid = figure.subplots(len(tasks), len(panels), squeeze=False)
    for row, (task, mine) in zip(grid, tasks.items(), strict=True):
        for axes, panel in zip(row, panels, strict=True):
            twins = {cell: found for cell, found in mine.items() if _panel(cell) == panel}
            axes.set_title(f"{task}: {panel}", fontsize=8)
            _draw_estimates(axes, twins, task_scene(task).true_theta)
    tidy(grid.ravel())
    return figure


def _pair() -> tuple[Figure, list[Axes]]:
    figure = new_figure(8, 3.0)
    panels = list(figure.subplots(1, 2))
    for axes, (_, _, title) in zip(panels, _PARTS, strict=True):
        axes.set_title(title, fontsize=9)
    return figure, panels


def _draw_estimates(axes: Axes, twins: Mapping[IdentifiedCell, Result | None], true: Mapping[str, float]) -> None:
    """Draws the true value of what twins are for, and those that they have, a column for each system."""
    systems = _grouped(twins, lambda cell: cell.system)
    axes.set_xticks(range(len(systems)), list(systems), fontsize=7)
    axes.set_xlim(-0.6, len(systems) - 0.4)
    for at, mine in enumerate(systems.values()):
        for x, (cell, found) in zip(_spread(at, list(mine)), mine.items(), strict=True):
            name, _ = unknown(cell)
            axes.axhline(true[name], color=TRUTH, linewidth=1.2, linestyle=":")
            axes.set_ylabel(f"{name} [{THETA[name]}]", fontsize=8)
            if found is None:
                axes.text(x, true[name], MISSING, ha="center", va="bottom", fontsize=7, color=GREY)
                continue
            estimate = found["estimates"][name]
            if estimate["interval"] is not None:
                axes.plot([x, x], estimate["interval"], color=TWIN, linewidth=1.2)
            filled = TWIN if estimate["identifiable"] or cell.system != PIN_WM else "white"
            axes.plot(x, estimate["value"], "o", color=TWIN, markerfacecolor=filled, markersize=5)


def _panel(cell: IdentifiedCell) -> str:
    return unknown(cell)[1].removesuffix(BESIDE)


def _rows_figure(
    results: Mapping[Made, Result | None], task_of: Callable[[Made], str], name_of: Callable[[Made], str]
) -> tuple[Figure, list[tuple[str, tuple[Axes, Axes], dict[str, list[Result]]]]]:
    """Figure with a row of two panels for each task of which a cell is made, and in these a row for each name.

    Returns:
        The figure; and of each task name, panels, and results by name of the row, empty where none is made.
    """
    tasks = {
        task: {name: _done(found) for name, found in _grouped(mine, name_of).items()}
        for task, mine in _grouped(results, task_of).items()
        if any(mine.values())
    }
    heights = [_FRAME + _ROW * len(rows) for rows in tasks.values()]
    figure = new_figure(10, sum(heights))
    grid = figure.subplots(len(tasks), 2, squeeze=False, height_ratios=heights)
    for pair, rows in zip(grid, tasks.values(), strict=True):
        for axes in pair:
            axes.set_yticks(range(len(rows)), list(rows) if axes is pair[0] else [""] * len(rows), fontsize=8)
            axes.set_ylim(len(rows) - 0.5, -0.5)
            for at, found in enumerate(rows.values()):
                if not found:
                    _note(axes, at, MISSING)
    tidy(grid.ravel())
    return figure, [(task, (pair[0], pair[1]), rows) for pair, (task, rows) in zip(grid, tasks.items(), strict=True)]


def _note(axes: Axes, at: int, words: str) -> None:
    axes.text(0.01, at, words, transform=axes.get_yaxis_transform(), va="center", fontsize=7, color=GREY)


def _spread(at: int, values: Sequence[Any]) -> list[float]:
    """Heights (n,) at which the seeds of a row are drawn."""
    steps = (k + 0.5 for k in range(len(values)))
    return [at + _SPREAD * (step / len(values) - 0.5) for step in steps]


def _of(kind: type[Made], results: Mapping[Any, Result | None]) -> dict[Made, Result | None]:
    return {cell: found for cell, found in results.items() if isinstance(cell, kind)}


def _grouped(results: Mapping[Made, Result | None], key: Callable[[Made], Key]) -> dict[Key, dict[Made, Result | None]]:
    """Results by what a key says of their cells, in the order of the cells."""
    groups: dict[Key, dict[Made, Result | None]] = {}
    for cell, found in results.items():
        groups.setdefault(key(cell), {})[cell] = found
    return groups


def _path(cell: Cell) -> str:
    return cell.key.partition("/")[2]


def _done(results: Mapping[Any, Result | None]) -> list[Result]:
    return [found for found in results.values() if found is not None]


def _mesh(cell: Predicted) -> tuple[float, str]:
    """Noise of the mesh that a twin was made with, by its diagonal, and words on its task and on the mesh."""
    twin = cell.twin if isinstance(cell, OneStepCell) else None
    capture = None if twin is None else twin.surfels.capture
    if not isinstance(capture, NoisyCaptureCell):
        return 0.0, cell.outcomes.task
    return capture.share, cell.outcomes.task + ", mesh fitted to the masks" * capture.refined
