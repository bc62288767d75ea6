"""What `pinwm identify` does: aligns if need be, identifies with a progress bar, and writes the twin."""

import shlex
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from pinwm_drake.capture.documents import read_json
from pinwm_drake.capture.episodes import Episode, read_episode
from pinwm_drake.capture.scene import Capture, read_capture
from pinwm_drake.capture.write import write_pose_table
from pinwm_drake.cli.align_run import run_align
from pinwm_drake.errors import InputError
from pinwm_drake.files import prepare_folder, replacing
from pinwm_drake.identification import Identification, IdentifyOptions, identify
from pinwm_drake.identification.checkpoint import CHECKPOINT_FILE
from pinwm_drake.identification.history import HISTORY_FILE
from pinwm_drake.identification.progress import Progress as Step
from pinwm_drake.provenance import timestamp, versions
from pinwm_drake.rendering.fit_options import FitOptions
from pinwm_drake.rendering.ply import read_ply
from pinwm_drake.report.twin.score import pose_errors
from pinwm_drake.twin import SURFELS_FILE, Estimate, Twin, write_twin

_ALIGN_FILE = "align.json"
# What the progress bar tells of theta.
_SHOWN = {"friction_floor": "μ floor", "friction_pusher": "μ pusher", "mass": "mass"}


def run_identify(path: Path, out: Path, *, episode_name: str | None, options: IdentifyOptions, resume: bool) -> None:
    """Makes a twin from a capture.

    Args:
        path: The capture.
        out: The twin's folder; made if need be.
        episode_name: Which push; None for the first.
        options: Of the identification.
        resume: Whether to go on from checkpoints in `out`.

    Raises:
        PinwmError: An input was refused, the physics found no solution, or a file cannot be written.
        SystemExit: With 1, when the user interrupts (Ctrl-C).
    """
    console = Console()
    capture = read_capture(path)
    if not capture.episode_names:
        raise InputError(path, value="no folder in episodes/", allowed="a capture with one push or more")
    episode = read_episode(capture, episode_name or capture.episode_names[0])
    prepare_folder(out)
    if not (out / SURFELS_FILE).is_file() or not (out / _ALIGN_FILE).is_file():
        console.print(f"no surfels in {out}: aligning first", highlight=False, soft_wrap=True)
        run_align(path, out, mesh_path=None, options=FitOptions(), resume=resume)
    surfels, offset = read_ply(out / SURFELS_FILE), read_offset(out / _ALIGN_FILE)
    if resume and not (out / CHECKPOINT_FILE).exists():
        console.print(f"no {CHECKPOINT_FILE} in {out}: starting anew", highlight=False, soft_wrap=True)
    result = _search(capture, episode, surfels, offset, options, out, resume, console)
    twin = replace(result.twin, provenance={**result.twin.provenance, **_provenance()})
    write_history(out / HISTORY_FILE, result)
    prepare_folder(out / "episodes")
    write_pose_table(out / "episodes" / f"{episode.name}.csv", result.poses)
    write_twin(out, twin)
    (out / CHECKPOINT_FILE).unlink(missing_ok=True)
    console.print(_summary(twin, result))
    if episode.object_poses is not None:
        errors = pose_errors(result.poses, episode.object_poses)
        if errors is not None:
            words = f"score against object_poses.csv, which was not used: {errors.words()}"
            console.print(words, highlight=False, soft_wrap=True)
    console.print(f"wrote {out / 'twin.yaml'}; look at it with: pinwm report {out}", highlight=False, soft_wrap=True)


def read_offset(path: Path) -> tuple[float, float]:
    """The camera's offset [px] that `pinwm align` found.

    Raises:
        InputError: The file cannot be used.
    """
    x, y = read_json(path)["camera_offset"].numbers(2).tolist()
    return x, y


def write_history(path: Path, result: Identification) -> None:
    """Writes every evaluation of the search.

    Raises:
        InputError: The file cannot be written.
    """
    names = result.found.problem.coordinates.names
    with replacing(path) as temporary:
        np.savez(temporary, allow_pickle=False, names=np.array(names), **result.found.log.arrays())


def _search(
    capture: Capture,
    episode: Episode,
    surfels: object,
    offset: tuple[float, float],
    options: IdentifyOptions,
    out: Path,
    resume: bool,
    console: Console,
) -> Identification:
    """The identification, with its progress; SystemExit where the user interrupts it."""
    columns = (
        TextColumn("identifying"),
        BarColumn(bar_width=20),
        TextColumn("{task.percentage:.0f} %  {task.fields[figures]}"),
        TimeElapsedColumn(),
    )
    with Progress(*columns, console=console) as progress:
        task = progress.add_task("", total=1.0, figures="getting ready (the first run compiles for minutes)")

        def report(step: Step) -> None:
            theta = "  ".join(f"{word} {step.values[name]:.3g}" for name, word in _SHOWN.items() if name in step.values)
            figures = f"{step.stage} ({step.support})  loss {step.loss:.5f}  {theta}"
            progress.update(task, completed=step.done, figures=figures)

        try:
            return identify(
                capture,
                episode,
                surfels,  # type: ignore[arg-type]
                offset,
                options,
                folder=out,
                resume=resume,
                report=report,
            )
        except KeyboardInterrupt:
            pass
    kept = "; go on with --resume" if (out / CHECKPOINT_FILE).exists() else ""
    console.print(f"interrupted{kept}")
    raise SystemExit(1)


def _provenance() -> dict[str, object]:
    """What only the command line knows."""
    return {
        "command": shlex.join(["pinwm", *sys.argv[1:]]),
        "created": timestamp(),
        "versions": versions(),
    }


def _summary(twin: Twin, result: Identification) -> Table:
    """Theta and nuisances."""
    table = Table("", "value", "95 % interval", "identifiable", title=f"Twin of {twin.name}")
    for name, estimate in {**twin.theta, **twin.nuisance}.items():
        table.add_row(name, *_row(estimate))
    losses = ", ".join(f"{support} {loss:.5f}" for support, loss in result.found.coarse_losses.items())
    loss = f"loss {result.found.loss:.5f}"
    table.caption = f"support: {twin.support} (coarse loss: {losses}); {loss}; {result.found.seconds:.0f} s"
    return table


def _row(estimate: Estimate) -> tuple[str, str, str]:
    unit = "" if estimate.unit == "1" else f" {estimate.unit}"
    interval = "" if estimate.interval is None else f"{estimate.interval[0]:.4g} to {estimate.interval[1]:.4g}"
    return f"{estimate.value:.4g}{unit}", interval, "yes" if estimate.identifiable else "no"
