"""Twins by ASID from captures and surfels that were fitted before."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from pinwm_drake.capture.episodes import ObjectPoses
from pinwm_drake.capture.write import write_pose_table
from pinwm_drake.errors import InputError
from pinwm_drake.experiments.progress import Progress, silent
from pinwm_drake.experiments.twins import has_surfels, read_pushes, run_provenance
from pinwm_drake.files import prepare_folder
from pinwm_drake.paper.baselines.asid.identify import AsidIdentification, identify_asid
from pinwm_drake.paper.baselines.asid.options import AsidOptions
from pinwm_drake.rendering.ply import read_ply
from pinwm_drake.report.surfels.fit_results import ALIGN_FILE, read_offset, read_registration
from pinwm_drake.twin.twin import SURFELS_FILE
from pinwm_drake.twin.write import write_twin


def asid_twin(
    path: Path,
    appearance: Path,
    out: Path,
    *,
    seed: int,
    episodes: Sequence[str] = (),
    options: AsidOptions | None = None,
    poses: Sequence[ObjectPoses] | None = None,
    progress: Progress = silent,
) -> AsidIdentification:
    """Makes a twin as ASID does and writes it, with the poses that it is to reproduce.

    Args:
        path: The capture.
        appearance: Folder with the surfels of the capture's object, as `pinwm align` leaves it; it is only read.
        out: The twin's folder; made if need be.
        seed: Seed of the search, 0 or more.
        episodes: Names of the pushes; none for the first.
        options: Settings; None for the default ones.
        poses: Poses of the object in each push; None for those of a `PoseTracker`.
        progress: Called with the stages "tracking" and "identifying".

    Returns:
        The identification; its `twin` is the one that was written.

    Raises:
        PinwmError: An input was refused, the physics found no solution, or a file cannot be written.
    """
    if not has_surfels(appearance):
        raise InputError(appearance, value="no surfels", allowed="a folder that `pinwm align` wrote")
    capture, pushes = read_pushes(path, episodes)
    prepare_folder(out / "episodes")
    progress("tracking" if poses is None else "identifying", 0.0, "getting ready")
    result = identify_asid(
        capture,
        pushes,
        read_ply(appearance / SURFELS_FILE),
        read_offset(appearance / ALIGN_FILE),
        options,
        seed=seed,
        X_OS=read_registration(appearance / ALIGN_FILE),
        poses=poses,
        report=lambda share: progress("identifying", share, "cross-entropy search"),
    )
    result = replace(result, twin=replace(result.twin, provenance={**result.twin.provenance, **run_provenance()}))
    for push, track in zip(pushes, result.poses, strict=True):
        write_pose_table(out / "episodes" / f"{push.name}.csv", track)
    write_twin(out, result.twin)
    return result
