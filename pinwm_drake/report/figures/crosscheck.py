"""Figure of a cross-check: differences of the engines after each push, and the paths of the worst one."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.ticker import MaxNLocator

from pinwm_drake.files import replacing
from pinwm_drake.report.outline import boundary, silhouette
from pinwm_drake.report.style import GREY, PUSHER, TRUTH, TWIN, new_figure, tidy

_COLOURS = (TWIN, TRUTH, "#3b8f5a", "#b07d1a")
_LEAST = 1e-2  # of a threshold: what is nearer than that is drawn there


@dataclass(frozen=True)
class Differences:
    """Differences of the twin and an engine, one number for each push.

    Attributes:
        engine: Name of the engine.
        translation: Distance of the objects after rest, m.
        rotation: Angle between the objects after rest, rad.
        passed: Verdict: whether the medians are within the thresholds.
    """

    engine: str
    translation: Sequence[float]
    rotation: Sequence[float]
    passed: bool


@dataclass(frozen=True, eq=False)
class PathFrom:
    """Path of the object in an engine.

    Attributes:
        engine: Name of the engine.
        t: (n,) s.
        p_WO: (n, 3) m, world.
        q_WO: (n, 4) wxyz.
    """

    engine: str
    t: np.ndarray
    p_WO: np.ndarray
    q_WO: np.ndarray


def crosscheck_figure(
    path: Path,
    differences: Sequence[Differences],
    *,
    thresholds: tuple[float, float],
    mesh: trimesh.Trimesh,
    worst: int,
    paths: Sequence[PathFrom],
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
        paths: Paths of that push, the twin's first.
        p_WP: (n, 3) m, path of the pusher, world.
        title: Title above the figure.

    Raises:
        InputError: The file cannot be written.
    """
    figure = new_figure(11, 6.2)
    figure.suptitle(title, fontsize=10)
    axes = figure.subplot_mosaic([["translation", "top"], ["rotation", "top"]], width_ratios=[1.25, 1])
    panels = (("translation", 1e3 * thresholds[0], 1e3, "mm"), ("rotation", np.degrees(thresholds[1]), None, "°"))
    for name, limit, scale, unit in panels:
        for k, one in enumerate(differences):
            values = np.asarray(getattr(one, name), float)
            values = np.degrees(values) if scale is None else scale * values
            _draw_differences(axes[name], one, values, float(limit), unit, _COLOURS[1 + k])
        axes[name].axhline(limit, color=GREY, linewidth=1.2, linestyle="--")
        axes[name].annotate(
            f"threshold of the median, {limit:g}{_spaced(unit)}",
            (0.0, limit),
            xycoords=("axes fraction", "data"),
            xytext=(3, 3),
            textcoords="offset points",
            fontsize=7,
            color=GREY,
        )
        axes[name].set_yscale("log")
        axes[name].xaxis.set_major_locator(MaxNLocator(integer=True))
        axes[name].set_ylabel(f"{name} after rest [{unit}]")
        axes[name].set_xlabel("push")
        axes[name].legend(frameon=False, fontsize=8, loc="lower left", bbox_to_anchor=(0.0, 1.0), ncol=2)
    _draw_paths(axes["top"], mesh, paths, p_WP)
    axes["top"].set_title(f"push {worst}, the worst one, from above", fontsize=9, color=GREY)
    tidy(axes.values())
    with replacing(path) as temporary:
        figure.savefig(temporary)


def _draw_differences(axes: Axes, one: Differences, values: np.ndarray, limit: float, unit: str, colour: str) -> None:
    """Draws a dot for each push and a line at the median; a push without an end is a cross at the top."""
    numbers, finite = np.arange(len(values)), np.isfinite(values)
    label = f"{one.engine}: median {_median(values):.2g}{_spaced(unit)}, {'PASS' if one.passed else 'FAIL'}"
    axes.plot(numbers[finite], np.maximum(values[finite], _LEAST * limit), "o", color=colour, markersize=4, label=label)
    if not finite.all():
        top = max(values[finite].max(initial=0.0), 10 * limit)
        axes.plot(numbers[~finite], np.full((~finite).sum(), top), "x", color=colour, label=f"{one.engine}: failed")
    if np.isfinite(_median(values)):
        axes.axhline(max(_median(values), _LEAST * limit), color=colour, linewidth=1.0)


def _spaced(unit: str) -> str:
    """Unit as it follows a number, with a space unless it is a degree sign."""
    return unit if unit == "°" else f" {unit}"


def _median(values: np.ndarray) -> float:
    with np.errstate(invalid="ignore"):
        middle = float(np.median(values))
    return np.inf if np.isnan(middle) else middle


def _draw_paths(axes: Axes, mesh: trimesh.Trimesh, paths: Sequence[PathFrom], p_WP: np.ndarray) -> None:
    """Draws outlines at the start and after rest, the paths of O, and that of the pusher; millimetres."""
    for k, path in enumerate(paths):
        colour = _COLOURS[k]
        if k == 0:
            _draw_outline(axes, mesh, path, 0, GREY)
        _draw_outline(axes, mesh, path, -1, colour)
        axes.plot(*(1e3 * path.p_WO[:, :2].T), color=colour, linewidth=1.2, label=path.engine)
    axes.plot(*(1e3 * p_WP[:, :2].T), color=PUSHER, linewidth=1, linestyle="--", label="pusher")
    axes.set_aspect("equal")
    axes.margins(0.05)
    axes.autoscale_view()
    axes.set_xlabel("x [mm]")
    axes.set_ylabel("y [mm]")
    axes.legend(frameon=False, fontsize=8, loc="upper center", bbox_to_anchor=(0.5, -0.12), ncol=len(paths) + 1)


def _draw_outline(axes: Axes, mesh: trimesh.Trimesh, path: PathFrom, at: int, colour: str) -> None:
    w, x, y, z = path.q_WO[at]
    R_WO = trimesh.transformations.quaternion_matrix([w, x, y, z])[:3, :3]
    outline = boundary(*silhouette(mesh, R_WO))
    axes.add_collection(LineCollection(1e3 * (outline + path.p_WO[at, :2]), colors=[colour], linewidths=1.3))
