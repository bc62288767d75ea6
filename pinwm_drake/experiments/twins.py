# SPDX-License-Identifier: MIT
"""Twins from captures: surfels, mass properties, friction and restitution of one pushed object."""

import shlex
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from pinwm_drake.capture.episodes import Episode, read_episode, tell_doubts
from pinwm_drake.capture.measured_poses import MeasuredPoses, poses_files, read_measured_poses
from pinwm_drake.capture.scene import Capture, load_capture
from pinwm_drake.capture.static_views import TRANSFORMS
from pinwm_drake.capture.write import write_pose_table
from pinwm_drake.cousins.domain import known_ranges
from pinwm_drake.errors import InputError
from pinwm_drake.experiments.alignment import align
from pinwm_drake.experiments.progress import Progress, silent
from pinwm_drake.files import occupying, prepare_folder
from pinwm_drake.geometry.meshes import load_mesh
from pinwm_drake.identification.checkpoint import CHECKPOINT_FILE
from pinwm_drake.identification.history import HISTORY_FILE, write_history
from pinwm_drake.identification.identify import Identification, identify_theta
from pinwm_drake.identification.options import IdentifyOptions
from pinwm_drake.identification.poses.fit import identify_poses
from pinwm_drake.identification.search import Progress as SearchProgress
from pinwm_drake.provenance import timestamp, versions
from pinwm_drake.rendering.fit_options import FitOptions
from pinwm_drake.rendering.painted import plain_surfels
from pinwm_drake.rendering.ply import read_ply
from pinwm_drake.report.live.page import ProgressPage
from pinwm_drake.report.surfels.fit_results import ALIGN_FILE, read_offset, read_registration
from pinwm_drake.spatial.poses import compose, identity, inverse
from pinwm_drake.tasks.registry import recipe_of, task_names
from pinwm_drake.twin.origin import seen_start
from pinwm_drake.twin.twin import SURFELS_FILE, Twin
from pinwm_drake.twin.write import write_twin

# Parameters that the progress shows.
_SHOWN = {"friction_floor": "μ floor", "friction_pusher": "μ pusher", "mass": "mass"}


def identify(
    path: str | Path,
    out: str | Path,
    *,
    episodes: Sequence[str] = (),
    options: IdentifyOptions | None = None,
    fit_options: FitOptions | None = None,
    appearance: Twin | None = None,
    poses: str | Path | None = None,
    resume: bool = False,
    view: bool = False,
    progress: Progress = silent,
) -> Identification:
    """Make a twin from a capture and write it: surfels where `out` has none yet, then theta of one push or more.

    Args:
        path: The capture.
        out: The twin's folder; made if need be.
        episodes: Names of the pushes; none for the first.
        options: Options of the identification; None for the default ones.
        fit_options: Options of the surfels' fit; None for the default ones.
        appearance: A twin of the same object and static views, whose surfels are used; None for those in `out`.
        poses: Measured poses of the object to fit to in place of images: a file, for one push, or the name of a file
            in the folder of each, such as object_poses.csv; see `read_measured_poses`. A capture without static views
            makes a grey twin then.
        resume: Flag: fit and identification go on from checkpoints in `out`; poses are fitted anew.
        view: Flag: `progress.html` in `out` shows the run while it goes on; see `ProgressPage`.
        progress: Called with stages "fitting" and "drawing" where surfels are fitted, and "identifying".

    Returns:
        The identification; its `twin` is the one that was written.

    Raises:
        PinwmError: An input was refused, the physics found no solution, or a file cannot be written.
    """
    path, out = Path(path), Path(out)
    capture, pushes = read_pushes(path, episodes)
    tables = None if poses is None else read_tables(capture, pushes, Path(poses))
    with occupying(out):
        if tables is not None and appearance is None and not (path / "static" / TRANSFORMS).is_file():
            surfels, offset = plain_surfels(load_mesh(capture.object.mesh_path)), (0.0, 0.0)
            X_OS = identity()
        elif appearance is not None:
            surfels, offset = appearance.surfels, appearance.camera_offset
            X_OS = compose(inverse(capture.object.X_WO), seen_start(appearance, capture))
        else:
            if not has_surfels(out):
                align(path, out, options=fit_options, resume=resume, view=view, progress=progress)
            surfels, offset = read_ply(out / SURFELS_FILE), read_offset(out / ALIGN_FILE)
            X_OS = read_registration(out / ALIGN_FILE)

        page = ProgressPage(out, f"Identification of {capture.object.name}") if view else None

        last: SearchProgress | None = None

        def searched(step: SearchProgress) -> None:
            nonlocal last
            last = step
            theta = "  ".join(f"{word} {step.values[name]:.3g}" for name, word in _SHOWN.items() if name in step.values)
            figures = f"loss {step.loss:.5f}  {theta}" if step.stage != "sample" else "draws from the posterior"
            progress("identifying", step.done, f"{step.stage}  {figures}")
            if page is not None:
                page.add(step.stage, step.loss)
                page.update(step.done, f"{step.stage}  {figures}", step.pairs)

        progress("identifying", 0.0, "getting ready; a new mesh is cut into pieces, once")
        options = IdentifyOptions() if options is None else options
        if tables is not None:
            result = identify_poses(capture, pushes, tables, surfels, offset, options, report=searched)
        else:
            result = identify_theta(
                capture, pushes, surfels, offset, options, X_OS=X_OS, folder=out, resume=resume, report=searched
            )
        if page is not None:
            pairs = list if last is None else last.pairs
            page.end(f"loss {result.found.loss:.5f} after {result.found.seconds:.0f} s", pairs)
        twin = replace(result.twin, provenance={**result.twin.provenance, **run_provenance()})
        result = replace(result, twin=twin)
        write_history(out / HISTORY_FILE, result.found.coordinates.names, result.found.log)
        prepare_folder(out / "episodes")
        for push, found in zip(pushes, result.poses, strict=True):
            write_pose_table(out / "episodes" / f"{push.name}.csv", found)
        write_twin(out, twin)
        if tables is None:
            (out / CHECKPOINT_FILE).unlink(missing_ok=True)
        return result


def read_pushes(path: Path, episodes: Sequence[str] = ()) -> tuple[Capture, list[Episode]]:
    """Return a capture and some of its pushes.

    Args:
        path: The capture.
        episodes: Names of the pushes; none for the first.

    Raises:
        InputError: There is no push, a file cannot be used, or its times cannot be seconds.
    """
    capture = load_capture(path)
    if not capture.episode_names:
        raise InputError(path, value="no folder in episodes/", allowed="a capture with one push or more")
    return capture, [tell_doubts(read_episode(capture, name)) for name in episodes or capture.episode_names[:1]]


def read_tables(capture: Capture, pushes: Sequence[Episode], poses: Path) -> list[MeasuredPoses]:
    """Return the measured poses of each push; see `identify`.

    Raises:
        InputError: A table cannot be used, or there is one file for several pushes.
    """
    paths = poses_files(poses, pushes)
    return [
        read_measured_poses(path, push.start or capture.object.X_WO) for path, push in zip(paths, pushes, strict=True)
    ]


def task_doubts(twin: Twin, pushes: Sequence[Episode]) -> list[str]:
    """Sentences on frictions with which tasks of pokes are not known to be possible; none where no push is a poke."""
    if not any(push.trajectory.motion == "poke" for push in pushes):
        return []
    recipes = [recipe_of(name) for name in task_names()]
    return [doubt for one in recipes if one.motion == "poke" for doubt in one.doubts(known_ranges(twin))]


def has_surfels(folder: Path) -> bool:
    """Flag: surfels have been fitted in a twin's folder."""
    return (folder / SURFELS_FILE).is_file() and (folder / ALIGN_FILE).is_file()


def run_provenance() -> dict[str, object]:
    """Entries of a twin's provenance that tell of the run: command, time and versions."""
    return {"command": shlex.join(["pinwm", *sys.argv[1:]]), "created": timestamp(), "versions": versions()}
