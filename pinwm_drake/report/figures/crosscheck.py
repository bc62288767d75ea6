# SPDX-License-Identifier: MIT
"""Figure of a cross-check: differences of the engines after each push, and the paths of the worst one."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator
from scipy.spatial.transform import Rotation

from pinwm_drake.report.outline import draw_outline
from pinwm_drake.report.style import (
    GREY,
    PUSHER,
    TRUTH,
    TWIN,
    label_plane,
    new_figure,
    plain_log,
    save_figure,
    tidy,
)

_COLOURS = (TWIN, TRUTH, "#3b8f5a", "#b07d1a", "#7d5ba6")
_LEAST = 1e-2  # of a threshold: what is nearer than that is drawn there


@dataclass(frozen=True)
class Differences:
    """Differences of the twin and an engine after rest, one number for each push."""

    engine: str
    translation: Sequence[float]  # m
    rotation: Sequence[float]  # rad
    passed: bool  # the medians are within the thresholds


def crosscheck_figure(
    path: Path,
    differences: Sequence[Differences],
    *,
    thresholds: tuple[float, float],
    mesh: trimesh.Trimesh,
    worst: int,
    paths: Mapping[str, tuple[np.ndarray, np.ndarray]],
    p_WP: np.ndarray,
    title: str,
) -> None:
    """Draws the figure of a cross-check.

    Args:
        path: File of the figure; the suffix names the format and the folder exists.
        differences: Differences of the twin and each engine.
        thresholds: Largest medians that pass, m and rad.
        mesh: The object, m, frame O.
        worst: Number of the push whose paths are drawn.
        paths: Paths of the object in that push, by engine, the twin's first: p_WO (n, 3) m and q_WO (n, 4) wxyz.
        p_WP: (n, 3) m, path of the pusher, world.
        title: Title above the figure.

    Raises:
        InputError: The file cannot be written.
    """
    figure = new_figure(11, 6.2)
    figure.suptitle(title, fontsize=10)
    axes = figure.subplot_mosaic([["translation", "top"], ["rotation", "top"]], width_ratios=[1.25, 1])
    panels = (("translation", 1e3 * thresholds[0], " mm"), ("rotation", float(np.degrees(thresholds[1])), "°"))
    for name, limit, unit in panels:
        for one, colour in zip(differences, _COLOURS[1:], strict=False):
            values = 1e3 * np.array(one.translation) if name == "translation" else np.degrees(one.rotation)
            _draw_differences(axes[name], one, values, limit, unit, colour)
        axes[name].axhline(limit, color=GREY, linewidth=1.2, linestyle="--")
        words, at = f"threshold of the median, {limit:.3g}{unit}", ("axes fraction", "data")
        axes[name].annotate(words, (0.0, limit), (3, 3), at, "offset points", fontsize=7, color=GREY)
        axes[name].xaxis.set_major_locator(MaxNLocator(integer=True))
        plain_log(axes[name])
        axes[name].set(xlabel="push", ylabel=f"{name} after rest [{unit.strip()}]")
        axes[name].legend(frameon=False, fontsize=8, loc="lower left", bbox_to_anchor=(0.0, 1.0), ncol=2)
    _draw_paths(axes["top"], mesh, paths, p_WP)
    axes["top"].set_title(f"push {worst}, the worst one, from above", fontsize=9, color=GREY)
    lines, names = axes["top"].get_legend_handles_labels()
    figure.legend(lines, names, frameon=False, fontsize=8, ncol=len(names), loc="outside lower right")
    tidy(axes.values())
    save_figure(path, figure)


def _draw_differences(axes: Axes, one: Differences, values: np.ndarray, limit: float, unit: str, colour: str) -> None:
    """Draws a dot for each push and a line at the median; a push without an end is a cross at the top."""
    numbers, finite = np.arange(len(values)), np.isfinite(values)
    with np.errstate(invalid="ignore"):
        median = float(np.nan_to_num(np.median(values), nan=np.inf, posinf=np.inf))
    told = f"median {median:.2g}{unit}" if np.isfinite(median) else "no median"
    label = f"{one.engine}: {told}, {'PASS' if one.passed else 'FAIL'}"
    axes.plot(numbers[finite], np.maximum(values[finite], _LEAST * limit), "o", color=colour, markersize=4, label=label)
    if not finite.all():
        top = max(values[finite].max(initial=0.0), 10 * limit)
        axes.plot(numbers[~finite], np.full((~finite).sum(), top), "x", color=colour, label=f"{one.engine}: failed")
    if np.isfinite(median):
        axes.axhline(max(median, _LEAST * limit), color=colour, linewidth=1.0)


def _draw_paths(
    axes: Axes, mesh: trimesh.Trimesh, paths: Mapping[str, tuple[np.ndarray, np.ndarray]], p_WP: np.ndarray
) -> None:
    """Draws outlines at the start and after rest, the paths of O, and that of the pusher; millimetres."""
    for k, (engine, (p_WO, q_WO)) in enumerate(paths.items()):
        for at, colour in ((0, GREY), (-1, _COLOURS[k])) if k == 0 else ((-1, _COLOURS[k]),):
            R_WO = Rotation.from_quat(q_WO[at], scalar_first=True).as_matrix()
            draw_outline(axes, mesh, R_WO, p_WO[at], colors=[colour], linewidths=1.3)
        axes.plot(*(1e3 * p_WO[:, :2].T), color=_COLOURS[k], linewidth=1.2, label=engine)
    axes.plot(*(1e3 * p_WP[:, :2].T), color=PUSHER, linewidth=1, linestyle="--", label="pusher")
    axes.set_aspect("equal")
    label_plane(axes)
