"""Output of `pinwm demo push`: progress, trajectory.csv, push.png, push.mp4 and a table."""

import csv
import math
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from pinwm_drake.demo.push import film as push_film
from pinwm_drake.demo.push import scene as push_scene
from pinwm_drake.demo.push.options import PushOptions
from pinwm_drake.files import replacing
from pinwm_drake.geometry.meshes import load_mesh
from pinwm_drake.models import model_path
from pinwm_drake.report.figures.push import push_figure
from pinwm_drake.report.video import write_video

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
    """Simulates a push and writes everything there is to see of it.

    Args:
        out: An existing folder.
        options: The push.

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

        result = push_scene.simulate_push(options, report)
        mesh = load_mesh(model_path(push_scene.BLOCK_MESH))
        _write_table(out / "trajectory.csv", result)
        speed, floor = f"{1e3 * options.speed:g} mm/s", f"friction {options.friction:g} on the floor"
        push_figure(
            out / "push.png",
            mesh,
            times=result.times,
            R_WB=result.R_WB,
            p_WB=result.p_WB,
            yaw=result.yaw,
            speed=np.linalg.norm(result.V_WB[:, 3:], axis=1),
            p_WP=result.p_WP,
            pusher_radius=push_scene.PUSHER_RADIUS,
            title=f"A {options.pusher} pushes the T-block at {speed}; {floor}",
        )
        frames = push_film.film(mesh, options.pusher, result, lambda share: report("film", share))
        frame_time = push_film.RECORDS_PER_FRAME * options.steps_per_record * options.time_step
        write_video(out / "push.mp4", frames, rate=1 / frame_time, size=push_film.SIZE)
    console.print(_summary(result))
    for name in ("trajectory.csv", "push.png", "push.mp4"):
        console.print(f"wrote {out / name}", highlight=False)


def _write_table(path: Path, result: push_scene.PushResult) -> None:
    """One row a recorded state; metres, seconds, radians, world frame."""
    rows = np.column_stack((result.times, result.p_WB, result.q_WB, result.V_WB, result.p_WP))
    with replacing(path) as temporary, temporary.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(_COLUMNS)
        writer.writerows([f"{value:.9g}" for value in row] for row in rows)


def _summary(result: push_scene.PushResult) -> Table:
    """Table of the outcome, with the derivatives of the final yaw."""
    table = Table("", "result", "by differences", title="Push of the T-block")
    moved = 1e3 * (result.p_WB[-1] - result.p_WB[0])
    table.add_row("moved in x and y", f"{moved[0]:.2f}, {moved[1]:.2f} mm")
    table.add_row("turned (yaw)", f"{math.degrees(result.yaw[-1]):.3f}°")
    table.add_row("highest speed", f"{1e3 * np.linalg.norm(result.V_WB[:, 3:], axis=1).max():.1f} mm/s")
    table.add_section()
    for row in result.derivatives:
        table.add_row(f"d yaw / d {row.name}", f"{row.adjoint:+.6g} {row.unit}", f"{row.difference:+.6g}")
    return table
