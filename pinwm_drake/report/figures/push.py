"""Figure of a push, drawn with matplotlib without its global state."""

from pathlib import Path

import numpy as np
import trimesh
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from pinwm_drake.files import replacing
from pinwm_drake.report.outline import silhouette

_BLOCK, _PUSHER, _GREY = "#c8432f", "#2f5d9e", "#8a8f98"
_SILHOUETTES = 7


def push_figure(
    path: Path,
    mesh: trimesh.Trimesh,
    *,
    times: np.ndarray,
    R_WB: np.ndarray,
    p_WB: np.ndarray,
    yaw: np.ndarray,
    speed: np.ndarray,
    p_WP: np.ndarray,
    pusher_radius: float,
    title: str,
) -> None:
    """Draws a push: silhouettes and paths from above, and path, yaw and speed over time.

    Args:
        path: File of the figure; the suffix names the format and the folder exists.
        mesh: The block, metres, body frame.
        times: (N,) [s].
        R_WB: (N, 3, 3), orientation of the block in the world.
        p_WB: (N, 3) [m], its origin in the world.
        yaw: (N,) [rad].
        speed: (N,) [m/s], of its origin.
        p_WP: (N, 3) [m], centre of the pusher in the world.
        pusher_radius: [m].
        title: Stands above the figure.

    Raises:
        InputError: When the file cannot be written.
    """
    figure = Figure(figsize=(10, 5.6), dpi=120, layout="constrained")
    figure.suptitle(title, fontsize=11)
    axes = figure.subplot_mosaic([["top", "path"], ["top", "yaw"], ["top", "speed"]], width_ratios=[1.15, 1])
    _draw_from_above(axes["top"], mesh, R_WB, p_WB, p_WP, pusher_radius, times)

    pusher_speed = np.linalg.norm(np.gradient(p_WP, times, axis=0), axis=1)
    axes["path"].plot(times, 1e3 * p_WB[:, 0], color=_BLOCK, linestyle="--", label="x")
    axes["path"].plot(times, 1e3 * p_WB[:, 1], color=_BLOCK, label="y")
    axes["path"].plot(times, 1e3 * p_WP[:, 1], color=_PUSHER, linewidth=1, label="y of the pusher")
    axes["path"].set_ylabel("position [mm]")
    axes["yaw"].plot(times, np.degrees(yaw), color=_BLOCK)
    axes["yaw"].set_ylabel("yaw [°]")
    axes["speed"].plot(times, 1e3 * speed, color=_BLOCK, label="block")
    axes["speed"].plot(times, 1e3 * pusher_speed, color=_PUSHER, linewidth=1, label="pusher")
    axes["speed"].set_ylabel("speed [mm/s]")
    axes["speed"].set_xlabel("time [s]")
    for name in ("path", "yaw", "speed"):
        axes[name].grid(color="#e3e5e8")
        axes[name].spines[["top", "right"]].set_visible(False)
        axes[name].set_xlim(times[0], times[-1])
    for name in ("path", "speed"):
        axes[name].legend(frameon=False, fontsize=8)
    with replacing(path) as temporary:
        figure.savefig(temporary)


def _draw_from_above(
    axes: Axes,
    mesh: trimesh.Trimesh,
    R_WB: np.ndarray,
    p_WB: np.ndarray,
    p_WP: np.ndarray,
    pusher_radius: float,
    times: np.ndarray,
) -> None:
    """Draws silhouettes of block and pusher at equal times, dark at the end, and both paths; millimetres."""
    for k in np.unique(np.linspace(0, len(times) - 1, _SILHOUETTES).round().astype(int)):
        share = times[k] / times[-1]
        colour = colormaps["Oranges"](0.25 + 0.55 * share)
        triangles, outline = silhouette(mesh, R_WB[k])
        triangles, outline = 1e3 * (triangles + p_WB[k, :2]), 1e3 * (outline + p_WB[k, :2])
        axes.add_collection(PolyCollection(triangles, facecolor=colour, edgecolor="none", alpha=0.55))
        axes.add_collection(LineCollection(outline, colors=[colour], linewidths=1.2))
        centre = tuple(1e3 * p_WP[k, :2])
        axes.add_patch(Circle(centre, 1e3 * pusher_radius, color=_PUSHER, alpha=0.2 + 0.6 * share, linewidth=0))
    axes.plot(*(1e3 * p_WB[:, :2].T), color=_BLOCK, linewidth=1.5, label="centre of mass")
    axes.plot(*(1e3 * p_WP[:, :2].T), color=_PUSHER, linewidth=1, linestyle="--", label="pusher")
    axes.set_aspect("equal")
    axes.margins(0.05)
    axes.autoscale_view()
    axes.set_xlabel("x [mm]")
    axes.set_ylabel("y [mm]")
    axes.set_title(f"from above, every {times[-1] / (_SILHOUETTES - 1):.2f} s", fontsize=9, color=_GREY)
    axes.grid(color="#e3e5e8")
    axes.set_axisbelow(True)
    axes.legend(frameon=False, fontsize=8, loc="upper center", bbox_to_anchor=(0.5, -0.09), ncol=2)
