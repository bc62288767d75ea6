"""What `pinwm align` does: reads, fits with a progress bar, and writes everything there is to see of the fit."""

import shutil
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import trimesh
from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeRemainingColumn
from rich.table import Table

from pinwm_drake.capture.objects import CAPTURE_FILE, read_capture_object
from pinwm_drake.capture.static_views import is_capture, read_views
from pinwm_drake.cli.align_report import write_results
from pinwm_drake.errors import InputError, ParameterError
from pinwm_drake.files import prepare_folder
from pinwm_drake.geometry.meshes import load_mesh
from pinwm_drake.rendering.checkpoint import FILE as CHECKPOINT_FILE
from pinwm_drake.rendering.fit_options import FitOptions
from pinwm_drake.rendering.fitting import FitResult, fit
from pinwm_drake.rendering.views import View
from pinwm_drake.spatial.rotations import quaternion_to_matrix

_CHECKPOINT_EVERY = 200  # iterations, some ten seconds
# What a run may write [bytes]: pictures and video; two checkpoints, page and PLY for each surfel.
_SPACE, _SPACE_PER_SURFEL = 32_000_000, 2500


@dataclass(frozen=True, eq=False)
class Source:
    """What a fit is made from.

    Attributes:
        path: The capture, or the folder of the images.
        mesh_path: The mesh's file.
        views: The posed images.
        mesh: The object, metres, frame O.
        up: (3,), unit, O: upwards in the world of the images.
    """

    path: Path
    mesh_path: Path
    views: list[View]
    mesh: trimesh.Trimesh
    up: np.ndarray


def run_align(path: Path, out: Path, *, mesh_path: Path | None, options: FitOptions, resume: bool) -> None:
    """Fits surfels to images and writes them, figures and a table.

    Args:
        path: A capture, or a folder with `transforms.json` and images, or that file.
        out: Where results go; made if need be.
        mesh_path: The object's mesh; None for that of the capture.
        options: Of the fit.
        resume: Whether to go on from the checkpoint in `out`, if there is one.

    Raises:
        PinwmError: An input was refused, or a file cannot be written.
        SystemExit: With 1, when the user interrupts the fit (Ctrl-C).
    """
    console = Console()
    source = read_source(path, mesh_path)
    prepare_folder(out)
    _require_space(out, options.max_surfels)
    if resume and not (out / CHECKPOINT_FILE).exists():
        console.print(f"no {CHECKPOINT_FILE} in {out}: starting anew", highlight=False, soft_wrap=True)
    result = _fit(source, out, replace(options, checkpoint_every=_CHECKPOINT_EVERY), resume, console)
    names = write_results(out, source.path, source.mesh_path, source.views, source.up, options, result, console)
    console.print(_summary(result))
    for name in names:
        console.print(f"wrote {out / name}", highlight=False, soft_wrap=True)


def read_source(path: Path, mesh_path: Path | None) -> Source:
    """Reads and checks images, poses and mesh.

    Args:
        path: A capture, or a folder with `transforms.json` and images, or that file.
        mesh_path: The object's mesh; None for that of the capture.

    Returns:
        What the fit needs.

    Raises:
        InputError: One of the files is missing or refused.
        ParameterError: The folder is no capture, and there is no mesh.
    """
    if is_capture(path):
        about = read_capture_object(path)
        mesh_path, X_WO, images = mesh_path or about.mesh_path, about.X_WO, path / "static"
        up = quaternion_to_matrix(X_WO.q)[2].numpy()
    elif not path.is_file() and not (path / "transforms.json").is_file():
        found = f"neither {CAPTURE_FILE} nor transforms.json" if path.is_dir() else "no such file or folder"
        raise InputError(path, value=found, allowed="a capture, or images with a nerfstudio transforms.json")
    elif mesh_path is None:
        raise ParameterError(
            f"--mesh: got none; allowed: the object's mesh, as {path} is no capture with one of its own"
        )
    else:
        X_WO, images, up = None, path, np.array([0.0, 0.0, 1.0])
    mesh = load_mesh(mesh_path)
    return Source(path, mesh_path, read_views(images, X_WO, mesh=mesh), mesh, up)


def _require_space(out: Path, max_surfels: int) -> None:
    """Raises InputError where the results would not fit the disk."""
    needed, free = _SPACE + _SPACE_PER_SURFEL * max_surfels, shutil.disk_usage(out).free
    if free < needed:
        raise InputError(out, value=f"{free / 1e6:.0f} MB of free space", allowed=f"{needed / 1e6:.0f} MB or more")


def _fit(source: Source, out: Path, options: FitOptions, resume: bool, console: Console) -> FitResult:
    """The fit, with its progress; SystemExit where the user interrupts it."""
    columns = (
        TextColumn("fitting {task.completed:.0f}/{task.total:.0f}"),
        BarColumn(bar_width=10),
        TextColumn("{task.fields[figures]}"),
        TimeRemainingColumn(),
        TextColumn("left"),
    )
    with Progress(*columns, console=console) as progress:
        task = progress.add_task("", total=options.iterations, figures="getting ready")

        def report(iteration: int, iterations: int, loss: float, psnr: float | None, surfels: int) -> None:
            _show(progress, task, iteration, loss, psnr, surfels)

        try:
            return fit(source.views, source.mesh, options, folder=out, resume=resume, progress=report)
        except KeyboardInterrupt:
            done = int(progress.tasks[0].completed)
    kept = "; go on with --resume" if (out / CHECKPOINT_FILE).exists() else ""
    console.print(f"interrupted after iteration {done}{kept}")
    raise SystemExit(1)


def _show(progress: Progress, task: TaskID, iteration: int, loss: float, psnr: float | None, surfels: int) -> None:
    quality = "" if psnr is None else f"  {psnr:.2f} dB"
    progress.update(task, completed=iteration, figures=f"loss {loss:.5f}{quality}  {surfels:,} surfels")


def _summary(result: FitResult) -> Table:
    """What came out."""
    table = Table("", "views", "mean PSNR", "lowest", "highest", title="Surfels fitted to images")
    for name, values in (("fitted", result.psnr_train), ("held out", result.psnr_test)):
        if values:
            decibels = list(values.values())
            figures = (f"{value:.2f} dB" for value in (np.mean(decibels), min(decibels), max(decibels)))
            table.add_row(name, str(len(values)), *figures)
    table.caption = f"{result.surfels.num_surfels:,} surfels in {result.seconds:.0f} s"
    return table
