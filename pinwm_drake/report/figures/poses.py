# SPDX-License-Identifier: MIT
"""Figures of the object's motion: over time, from above, and its error against the truth."""

import numpy as np
import trimesh
from matplotlib import colormaps
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from scipy.spatial.transform import Rotation

from pinwm_drake.capture.episodes import ObjectPoses, PusherTrajectory
from pinwm_drake.report.outline import draw_outline, silhouette
from pinwm_drake.report.style import GREY, PUSHER, TRUTH, TWIN, evenly, label_plane, new_figure, tidy
from pinwm_drake.report.twin.score import PoseErrors
from pinwm_drake.twin.predict import TWO_SIDED, Spread

_OUTLINES = 6
_TRUTH_LABEL = "recorded"


def motion_figure(
    poses: ObjectPoses,
    truth: ObjectPoses | None,
    pusher: PusherTrajectory | None,
    spread: Spread | None = None,
) -> Figure:
    """Figure of x, y and yaw of the object over time, in a band of 95 % where a spread is known, and of the pusher."""
    figure = new_figure(9, 5.6)
    panels = figure.subplots(3, 1, sharex=True)
    known = _curves(truth) if truth is not None else []
    sigmas = [] if spread is None else [1e3 * spread.x, 1e3 * spread.y, np.degrees(spread.yaw)]
    for k, (axes, values) in enumerate(zip(panels, _curves(poses), strict=True)):
        if pusher is not None and k < 2:
            shown = (pusher.t >= poses.t[0]) & (pusher.t <= poses.t[-1])
            axes.plot(pusher.t[shown], 1e3 * pusher.p_WP[shown, k], color=PUSHER, linewidth=1, label="pusher")
        axes.plot(poses.t, values, color=TWIN, linewidth=1.6, marker=".", markersize=4, label="twin")
        if truth is not None:
            axes.plot(truth.t, known[k], "o", color=TRUTH, markersize=3.5, fillstyle="none", label=_TRUTH_LABEL)
        if sigmas:
            band = (values - TWO_SIDED * sigmas[k], values + TWO_SIDED * sigmas[k])
            axes.fill_between(poses.t, *band, color=TWIN, alpha=0.18, linewidth=0, label="95 %")
        axes.set_ylabel(("x [mm]", "y [mm]", "yaw [°]")[k])
    panels[2].set_xlabel("time [s]")
    panels[0].legend(frameon=False, fontsize=8, loc="lower left", bbox_to_anchor=(0, 1), ncol=4)
    tidy(panels)
    return figure


def top_figure(
    mesh: trimesh.Trimesh,
    poses: ObjectPoses,
    truth: ObjectPoses | None,
    pusher_mesh: trimesh.Trimesh,
    pusher: PusherTrajectory | None,
) -> Figure:
    """Figure of outlines from above at equal times, dark at the end, with the paths; truth as dashed outlines."""
    figure = new_figure(6.4, 5.6)
    axes = figure.subplots()
    for k in evenly(len(poses.t), _OUTLINES):
        share = k / max(len(poses.t) - 1, 1)
        colour = colormaps["Oranges"](0.25 + 0.55 * share)
        R_WO, p_WO = _matrices(poses.q_WO[k]), poses.p_WO[k]
        triangles = 1e3 * (silhouette(mesh, R_WO)[0] + p_WO[:2])
        axes.add_collection(PolyCollection(list(triangles), facecolor=colour, edgecolor="none", alpha=0.4))
        draw_outline(axes, mesh, R_WO, p_WO, colors=[colour], linewidths=1.4)
        if pusher is not None:
            near = int(np.abs(pusher.t - poses.t[k]).argmin())
            R_WP, p_WP, alpha = _matrices(pusher.q_WP[near]), pusher.p_WP[near], 0.3 + 0.6 * share
            draw_outline(axes, pusher_mesh, R_WP, p_WP, colors=[PUSHER], linewidths=1, alpha=alpha)
        if truth is not None:
            row = int(np.abs(truth.t - poses.t[k]).argmin())
            R_WO, p_WO = _matrices(truth.q_WO[row]), truth.p_WO[row]
            draw_outline(axes, mesh, R_WO, p_WO, colors=[TRUTH], linewidths=0.9, linestyles=":")
    axes.plot(*(1e3 * poses.p_WO[:, :2].T), color=TWIN, linewidth=1.5, label="origin of the object, twin")
    if truth is not None:
        x, y = 1e3 * truth.p_WO[:, :2].T
        axes.plot(x, y, "o", label=_TRUTH_LABEL, color=TRUTH, markersize=3.5, fillstyle="none")
    if pusher is not None:
        shown = (pusher.t >= poses.t[0]) & (pusher.t <= poses.t[-1])
        axes.plot(*(1e3 * pusher.p_WP[shown, :2].T), color=PUSHER, linewidth=1, linestyle="--", label="pusher")
    axes.set_aspect("equal", adjustable="datalim")
    label_plane(axes)
    axes.legend(frameon=False, fontsize=8, loc="lower left", bbox_to_anchor=(0, 1), ncol=2)
    tidy([axes])
    return figure


def error_figure(errors: PoseErrors) -> Figure:
    """Figure of position and rotation error over time, with their means."""
    figure = new_figure(9, 3.0)
    panels = figure.subplots(1, 2)
    for axes, values, label, unit in (
        (panels[0], 1e3 * errors.position, "position error in the plane", " mm"),
        (panels[1], np.degrees(errors.rotation), "rotation error", "°"),
    ):
        axes.plot(errors.t, values, color=TWIN, marker=".", markersize=4)
        axes.axhline(values.mean(), color=GREY, linewidth=1, linestyle="--")
        axes.set_title(f"mean {values.mean():.2f}{unit}, largest {values.max():.2f}{unit}", fontsize=9)
        top = max(1.15 * values.max(), 1e-3)
        axes.set(xlabel="time [s]", ylabel=f"{label} [{unit.strip()}]", ylim=(0, top))
    tidy(panels)
    return figure


def _curves(poses: ObjectPoses) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Curves of x and y [mm], and of yaw [deg] without jumps."""
    R_WO = _matrices(poses.q_WO)
    yaw = np.unwrap(np.arctan2(R_WO[:, 1, 0], R_WO[:, 0, 0]))
    return 1e3 * poses.p_WO[:, 0], 1e3 * poses.p_WO[:, 1], np.degrees(yaw)


def _matrices(q: np.ndarray) -> np.ndarray:
    return Rotation.from_quat(q, scalar_first=True).as_matrix()
