"""The figure of the push."""

from pathlib import Path

import numpy as np
import trimesh
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.patches import Circle

from pinwm_drake.demo.push.scene import PUSHER_RADIUS, PushRecord
from pinwm_drake.report.outline import silhouette
from pinwm_drake.report.style import GREY, GRID, PUSHER, TWIN, evenly, label_plane, new_figure, save_figure, tidy

_SILHOUETTES = 7


def push_figure(path: Path, mesh: trimesh.Trimesh, record: PushRecord, title: str) -> None:
    """Draws a push: silhouettes and paths from above, and path, yaw and speed over time.

    Args:
        path: File of the figure; the suffix names the format and the folder exists.
        mesh: The block, m, body frame.
        record: The push.
        title: Stands above the figure.

    Raises:
        InputError: When the file cannot be written.
    """
    figure = new_figure(10, 5.6, dpi=120)
    figure.suptitle(title, fontsize=11)
    axes = figure.subplot_mosaic([["top", "path"], ["top", "yaw"], ["top", "speed"]], width_ratios=[1.15, 1])
    _draw_from_above(axes["top"], mesh, record)
    times, p_WB, p_WP = record.times, 1e3 * record.p_WB, 1e3 * record.p_WP
    axes["path"].plot(times, p_WB[:, 0], color=TWIN, linestyle="--", label="x")
    axes["path"].plot(times, p_WB[:, 1], color=TWIN, label="y")
    axes["path"].plot(times, p_WP[:, 1], color=PUSHER, linewidth=1, label="y of the pusher")
    axes["yaw"].plot(times, np.degrees(record.yaw), color=TWIN)
    axes["speed"].plot(times, 1e3 * record.speed, color=TWIN, label="block")
    pusher_speed = np.linalg.norm(np.gradient(p_WP, times, axis=0), axis=1)
    axes["speed"].plot(times, pusher_speed, color=PUSHER, linewidth=1, label="pusher")
    axes["speed"].set_xlabel("time [s]")
    for name, label in {"path": "position [mm]", "yaw": "yaw [°]", "speed": "speed [mm/s]"}.items():
        axes[name].set(ylabel=label, xlim=(times[0], times[-1]))
        if name != "yaw":
            axes[name].legend(frameon=False, fontsize=8)
    tidy(axes[name] for name in ("path", "yaw", "speed"))
    save_figure(path, figure)


def _draw_from_above(axes: Axes, mesh: trimesh.Trimesh, record: PushRecord) -> None:
    """Draws silhouettes of block and pusher at equal times, dark at the end, and both paths; millimetres."""
    times, p_WB, p_WP = record.times, 1e3 * record.p_WB[:, :2], 1e3 * record.p_WP[:, :2]
    for k in evenly(len(times), _SILHOUETTES):
        share = times[k] / times[-1]
        colour = colormaps["Oranges"](0.25 + 0.55 * share)
        triangles, outline = (1e3 * part + p_WB[k] for part in silhouette(mesh, record.R_WB[k]))
        axes.add_collection(PolyCollection(triangles, facecolor=colour, edgecolor="none", alpha=0.55))
        axes.add_collection(LineCollection(outline, colors=[colour], linewidths=1.2))
        alpha = 0.2 + 0.6 * share
        axes.add_patch(Circle(tuple(p_WP[k]), 1e3 * PUSHER_RADIUS, color=PUSHER, alpha=alpha, linewidth=0))
    axes.plot(*p_WB.T, color=TWIN, linewidth=1.5, label="centre of mass")
    axes.plot(*p_WP.T, color=PUSHER, linewidth=1, linestyle="--", label="pusher")
    axes.set_aspect("equal")
    label_plane(axes)
    axes.set_title(f"from above, every {times[-1] / (_SILHOUETTES - 1):.2f} s", fontsize=9, color=GREY)
    axes.grid(color=GRID)
    axes.set_axisbelow(True)
    axes.legend(frameon=False, fontsize=8, loc="upper center", bbox_to_anchor=(0.5, -0.09), ncol=2)
