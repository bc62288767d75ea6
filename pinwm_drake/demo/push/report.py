# SPDX-License-Identifier: MIT
"""Output of `pinwm demo push`: progress, trajectory.csv, push.png, push.mp4 and a table."""

import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import cast

import numpy as np
import trimesh
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.patches import Circle
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from pinwm_drake.capture.pusher import pusher_surface
from pinwm_drake.capture.scene import PusherGeometry, PusherKind, PusherShape
from pinwm_drake.demo.push.options import PushOptions
from pinwm_drake.demo.push.scene import BLOCK_MESH, PUSHER_LENGTH, PUSHER_RADIUS, PushRecord, simulate_push
from pinwm_drake.files import replacing
from pinwm_drake.geometry.meshes import load_mesh
from pinwm_drake.models import model_path
from pinwm_drake.report.camera import ViewCamera
from pinwm_drake.report.captions import write_caption
from pinwm_drake.report.outline import silhouette
from pinwm_drake.report.scene import Actor, Stage
from pinwm_drake.report.style import (
    BELOW_LABEL,
    GREY,
    GRID,
    PUSHER,
    TWIN,
    evenly,
    label_plane,
    new_figure,
    save_figure,
    tidy,
)
from pinwm_drake.report.video import write_video

_SIZE = (960, 540)  # px, of the film
_RECORDS_PER_FRAME = 2  # of about 60 a second
_BLOCK_COLOUR, _PUSHER_COLOUR = (0.75, 0.16, 0.10), (0.10, 0.25, 0.55)
_SILHOUETTES = 7
# Position, quaternion, angular and linear velocity of the block; position of the pusher.
_COLUMNS = (
    *("t", "px", "py", "pz", "qw", "qx", "qy", "qz", "wx", "wy", "wz", "vx", "vy", "vz"),
    *("pusher_x", "pusher_y", "pusher_z"),
)
_STAGES = {
    "simulate": "rolling out",
    "differentiate": "differentiating",
    "check": "checking by differences",
    "film": "filming",
}


def run_push(out: Path, options: PushOptions) -> None:
    """Simulate a push and write everything there is to see of it into an existing folder.

    Raises:
        PinwmError: When the simulation refuses an input, or a file cannot be written.
    """
    console = Console()
    columns = (TextColumn("{task.description:<24}"), BarColumn(), TextColumn("{task.percentage:>3.0f}%"))
    with Progress(*columns, TimeElapsedColumn(), console=console) as progress:
        tasks = {name: progress.add_task(text, total=1.0, start=False) for name, text in _STAGES.items()}

        def report(stage: str, share: float) -> None:
            progress.start_task(tasks[stage])
            progress.update(tasks[stage], completed=share)

        record = simulate_push(options, report)
        mesh = load_mesh(model_path(BLOCK_MESH))
        _write_table(out / "trajectory.csv", record)
        speed, floor = f"{1e3 * options.speed:g} mm/s", f"friction {options.friction:g} on the floor"
        push_figure(out / "push.png", mesh, record, f"A {options.pusher} pushes the T-block at {speed}; {floor}")
        frames = _film(mesh, options.pusher, record, lambda share: report("film", share))
        frame_time = _RECORDS_PER_FRAME * options.steps_per_record * options.time_step
        write_video(out / "push.mp4", frames, rate=1 / frame_time, size=_SIZE)
    console.print(_summary(record))
    for name in ("trajectory.csv", "push.png", "push.mp4"):
        console.print(f"wrote {out / name}", highlight=False)


def _write_table(path: Path, record: PushRecord) -> None:
    """One row a recorded state; metres, seconds, radians, world frame."""
    rows = np.column_stack((record.times, record.p_WB, record.q_WB, record.V_WB, record.p_WP))
    with replacing(path) as temporary:
        np.savetxt(temporary, rows, "%.9g", ",", "\r\n", header=",".join(_COLUMNS), comments="")


def _summary(record: PushRecord) -> Table:
    table = Table("", "result", "by differences", title="Push of the T-block")
    moved = 1e3 * (record.p_WB[-1] - record.p_WB[0])
    table.add_row("moved in x and y", f"{moved[0]:.2f}, {moved[1]:.2f} mm")
    table.add_row("turned (yaw)", f"{math.degrees(record.yaw[-1]):.3f}°")
    table.add_row("highest speed", f"{1e3 * record.speed.max():.1f} mm/s")
    table.add_section()
    for row in record.derivatives:
        table.add_row(f"d yaw / d {row.name}", f"{row.adjoint:+.6g} {row.unit}", f"{row.difference:+.6g}")
    return table


def push_figure(path: Path, mesh: trimesh.Trimesh, record: PushRecord, title: str) -> None:
    """Draws a push: silhouettes and paths from above, and path, yaw and speed over time.

    The mesh is that of the block, m, body frame. Raises InputError where the file cannot be written.
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
    axes.legend(
        frameon=False, fontsize=8, ncol=2, loc="upper center", bbox_to_anchor=(0.5, 0.0), borderaxespad=BELOW_LABEL
    )


def _film(
    mesh: trimesh.Trimesh, pusher: str, record: PushRecord, report: Callable[[float], None]
) -> Iterator[np.ndarray]:
    """Draws the push in real time: frames (height, width, 3) uint8, sRGB."""
    actor = Actor.from_mesh(mesh, _BLOCK_COLOUR, smooth=False)
    surface = pusher_surface(PusherGeometry(None, PusherShape(cast(PusherKind, pusher), PUSHER_RADIUS, PUSHER_LENGTH)))
    pusher_actor = Actor.from_mesh(surface, _PUSHER_COLOUR, smooth=pusher != "cylinder")
    stage = Stage(_camera(record))
    p_WB, p_WP = record.p_WB, record.p_WP
    for k in range(0, len(record.times), _RECORDS_PER_FRAME):
        frame = stage.picture(
            [(actor, record.R_WB[k], p_WB[k]), (pusher_actor, np.eye(3), p_WP[k])],
            [(p_WB[: k + 1, :2], _BLOCK_COLOUR), (p_WP[: k + 1, :2], _PUSHER_COLOUR)],
        )
        moved, turned = 1e3 * np.linalg.norm(p_WB[k, :2] - p_WB[0, :2]), math.degrees(record.yaw[k])
        write_caption(frame, f"{record.times[k]:4.2f} s   moved {moved:3.0f} mm   turned {turned:+4.0f}°")
        yield frame
        report(min(1.0, (k + _RECORDS_PER_FRAME) / len(record.times)))


def _camera(record: PushRecord) -> ViewCamera:
    """Return a view from the side and above that holds the whole push, with room for the block around its path."""
    places = np.concatenate((record.p_WB[:, :2], record.p_WP[:, :2]))
    low, high = places.min(axis=0) - 0.06, places.max(axis=0) + 0.06
    target = np.array([*(low + high) / 2, 0.01])
    eye = target + 1.55 * np.linalg.norm(high - low) * np.array([0.72, -0.42, 0.55])
    return ViewCamera.look_at(eye, target, width=_SIZE[0], height=_SIZE[1], field_of_view=math.radians(30))
