"""Figure of one-step errors over the iterations of identifications."""

from collections.abc import Mapping, Sequence
from typing import Any

from matplotlib.figure import Figure

from pinwm_drake.report.style import new_figure, tidy

_PANELS = (("translation", 1e3, "translation [mm]"), ("rotation", 1.0, "rotation [rad]"))


def one_step_figure(curves: Mapping[str, Sequence[Mapping[str, Any]]]) -> Figure:
    """Figure of mean errors over the iterations.

    Args:
        curves: Points of each identification, by its name: `iteration`, and the `mean` of `translation` [m] and of
            `rotation` [rad].
    """
    figure = new_figure(8, 3.0)
    panels = figure.subplots(1, 2)
    for axes, (part, scale, title) in zip(panels, _PANELS, strict=True):
        for name, points in curves.items():
            means = [scale * point[part]["mean"] for point in points]
            axes.plot([point["iteration"] for point in points], means, marker=".", label=name)
        axes.set_title(title, fontsize=9)
        axes.set_xlabel("iteration")
        axes.set_yscale("log")
    panels[0].legend(frameon=False, fontsize=8)
    tidy(panels)
    return figure
