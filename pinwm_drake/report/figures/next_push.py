# SPDX-License-Identifier: MIT
"""Picture of the push that would tell most, from above."""

from pathlib import Path

import numpy as np
import trimesh

from pinwm_drake.report.outline import draw_outline
from pinwm_drake.report.style import GREY, PUSHER, TRUTH, TWIN, new_figure, save_figure, tidy
from pinwm_drake.spatial.poses import Pose
from pinwm_drake.spatial.rotations import quaternion_to_matrix

_SHOWN = 24  # draws


def next_push_figure(
    path: Path,
    mesh: trimesh.Trimesh,
    X_WO: Pose,
    X_WO_after: Pose,
    *,
    starts: np.ndarray,
    ends: np.ndarray,
    informations: np.ndarray,
    spreads: np.ndarray,
) -> None:
    """Draws the object, the pushes that were looked at, and where the best of them takes it by the twin's draws.

    Args:
        path: A .png file.
        mesh: The object, m, frame O.
        X_WO: Its pose before a push, q (4,), p (3,) [m].
        X_WO_after: Poses of the object after the best push, by draws: q (W, 4), p (W, 3) [m].
        starts, ends: Places of the pusher before and after each push, the best one's first, (n, 2) [m].
        informations: Information that each is expected to give, (n,) nats.
        spreads: Standard deviations of where it ends, (n,) [m].

    Raises:
        InputError: The file cannot be written.
    """
    figure = new_figure(10.0, 4.6)
    left, right = figure.subplots(1, 2, width_ratios=(3, 2))
    after = quaternion_to_matrix(X_WO_after.q[:_SHOWN]).numpy()
    outlines = [(quaternion_to_matrix(X_WO.q).numpy(), X_WO.p.numpy(), TRUTH, 1.5, 1.0)]
    outlines += [(R_WO, p_WO, TWIN, 0.6, 0.35) for R_WO, p_WO in zip(after, X_WO_after.p.numpy(), strict=False)]
    for R_WO, p_WO, colour, width, opacity in outlines:
        draw_outline(left, mesh, R_WO, p_WO, colors=colour, lw=width, alpha=opacity)
    for k, (start, end) in reversed(list(enumerate(zip(1e3 * starts, 1e3 * ends, strict=True)))):
        colour, width = (GREY, 0.6) if k else (PUSHER, 2.5)
        arrow = {"arrowstyle": "->", "color": colour, "lw": width, "shrinkA": 0, "shrinkB": 0}
        left.annotate("", tuple(end), tuple(start), arrowprops=arrow)
        left.plot(*np.array([start, end]).T, alpha=0.0)
    left.set(aspect="equal", xlabel="x [mm]", ylabel="y [mm]", title="the push, and where the twin's draws have it end")
    left.autoscale_view()
    right.scatter(1e3 * spreads, informations, s=14, color=GREY)
    right.scatter(1e3 * spreads[:1], informations[:1], s=50, color=PUSHER)
    right.set(xlabel="spread at rest [mm]", ylabel="expected information [nats]", title="all that were looked at")
    tidy([left, right])
    save_figure(path, figure)
