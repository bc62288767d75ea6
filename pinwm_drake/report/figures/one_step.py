"""Figure of one-step errors over the iterations of identifications."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pinwm_drake.files import replacing
from pinwm_drake.report.style import new_figure, tidy

_PANELS = (("translation", 1e3, "translation [mm]"), ("rotation", 1.0, "rotation [rad]"))


def one_step_figure(path: Path, curves: Mapping[str, Sequence[Mapping[str, Any]]]) -> Path:
    """Draws mean errors over the iterations.

    Args:
        path: File of the figure.
        curves: Points of each identification, by its name: `iteration`, and the `mean` of `translation` [m] and of
            `rotation` [rad].

    Returns:
        The path.

    Raises:
        InputError: The picture cannot be written.
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
    with replacing(path) as temporary:
        figure.savefig(temporary)
    return path
