"""Output of `pinwm demo push`: progress, trajectory.csv, push.png, push.mp4 and a table."""

import math
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from pinwm_drake.demo.push.figure import push_figure
from pinwm_drake.demo.push.film import RECORDS_PER_FRAME, SIZE, film
from pinwm_drake.demo.push.options import PushOptions
from pinwm_drake.demo.push.scene import BLOCK_MESH, PushRecord, simulate_push
from pinwm_drake.files import replacing
from pinwm_drake.geometry.meshes import load_mesh
from pinwm_drake.models import model_path
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

        record = simulate_push(options, report)
        mesh = load_mesh(model_path(BLOCK_MESH))
        _write_table(out / "trajectory.csv", record)
        speed, floor = f"{1e3 * options.speed:g} mm/s", f"friction {options.friction:g} on the floor"
        push_figure(out / "push.png", mesh, record, f"A {options.pusher} pushes the T-block at {speed}; {floor}")
        frames = film(mesh, options.pusher, record, lambda share: report("film", share))
        frame_time = RECORDS_PER_FRAME * options.steps_per_record * options.time_step
        write_video(out / "push.mp4", frames, rate=1 / frame_time, size=SIZE)
    console.print(_summary(record))
    for name in ("trajectory.csv", "push.png", "push.mp4"):
        console.print(f"wrote {out / name}", highlight=False)


def _write_table(path: Path, record: PushRecord) -> None:
    """One row a recorded state; metres, seconds, radians, world frame."""
    rows = np.column_stack((record.times, record.p_WB, record.q_WB, record.V_WB, record.p_WP))
    with replacing(path) as temporary:
        np.savetxt(temporary, rows, "%.9g", ",", "\r\n", header=",".join(_COLUMNS), comments="")


def _summary(record: PushRecord) -> Table:
    """Table of the outcome, with the derivatives of the final yaw."""
    table = Table("", "result", "by differences", title="Push of the T-block")
    moved = 1e3 * (record.p_WB[-1] - record.p_WB[0])
    table.add_row("moved in x and y", f"{moved[0]:.2f}, {moved[1]:.2f} mm")
    table.add_row("turned (yaw)", f"{math.degrees(record.yaw[-1]):.3f}°")
    table.add_row("highest speed", f"{1e3 * record.speed.max():.1f} mm/s")
    table.add_section()
    for row in record.derivatives:
        table.add_row(f"d yaw / d {row.name}", f"{row.adjoint:+.6g} {row.unit}", f"{row.difference:+.6g}")
    return table
