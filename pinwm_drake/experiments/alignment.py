# SPDX-License-Identifier: MIT
"""The fit of surfels to posed images of an object, with all files that it leaves."""

import shutil
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
import trimesh

from pinwm_drake.capture.checks.pictures import Agreement, compare
from pinwm_drake.capture.paths import is_file
from pinwm_drake.capture.scene import CAPTURE_FILE, read_capture_object
from pinwm_drake.capture.static_views import read_views
from pinwm_drake.errors import InputError, ParameterError
from pinwm_drake.experiments.progress import Progress, silent
from pinwm_drake.files import occupying
from pinwm_drake.geometry.meshes import load_mesh
from pinwm_drake.rendering.fit_options import FitOptions
from pinwm_drake.rendering.fitting import FitResult, Now, fit
from pinwm_drake.rendering.registration import Registration, measure_size, register, registered
from pinwm_drake.rendering.render import render
from pinwm_drake.rendering.silhouette import silhouette
from pinwm_drake.rendering.surfels import Surfels
from pinwm_drake.rendering.views import View
from pinwm_drake.report.live.page import Pair, ProgressPage
from pinwm_drake.report.style import box_around, evenly
from pinwm_drake.report.surfels.fit_results import write_fit_results
from pinwm_drake.spatial.rotations import quaternion_to_matrix

_SHOWN = 4  # views on the page of a fit
_CHECKPOINT_EVERY = 200  # iterations, some ten seconds
# A mesh fits where outlines and masks overlap by so much, but for a rim, in all but so many views, at a place that is
# so near to the given one [m]: see docs/lab-book/2026-11-28-mesh-that-does-not-fit.md.
_FITS, _EXCEPT, _NEAR = 0.75, 0.25, 0.015
_AS_LARGE, _AS_HIGH = 0.06, 0.006  # how far size and height [m] may be from those of the masks
# Bytes that a run may write: pictures and video; two checkpoints, page and PLY for each surfel.
_SPACE, _SPACE_PER_SURFEL = 32_000_000, 2500


@dataclass(frozen=True, eq=False)
class Source:
    """Images, poses and mesh of a fit.

    Attributes:
        path: The capture, or the folder of the images.
        mesh_path: File of the mesh.
        views: The posed images.
        mesh: Mesh of the object, m, frame O.
        up: (3,) unit vector, frame O: upwards in the world of the images.
    """

    path: Path
    mesh_path: Path
    views: list[View]
    mesh: trimesh.Trimesh
    up: np.ndarray


def align(
    path: str | Path,
    out: str | Path,
    *,
    mesh_path: Path | None = None,
    options: FitOptions | None = None,
    resume: bool = False,
    view: bool = False,
    progress: Progress = silent,
) -> FitResult:
    """Fits surfels to images and writes them, figures, a page and a film; see `fit_results.FILES`.

    Args:
        path: A capture, or a folder with `transforms.json` and images, or that file.
        out: Folder of the results; made if need be.
        mesh_path: The object's mesh; None for that of the capture.
        options: Options of the fit; None for the default ones.
        resume: Flag: the fit goes on from the checkpoint in `out`, if there is one.
        view: Flag: `progress.html` in `out` shows the fit while it goes on; see `ProgressPage`.
        progress: Called while the fit goes on, stage "fitting", and while it is drawn, stage "drawing".

    Returns:
        The fit.

    Raises:
        PinwmError: An input was refused, or a file cannot be written.
    """
    path, out = Path(path), Path(out)
    options = FitOptions() if options is None else options
    source = read_source(path, mesh_path)
    with occupying(out):
        _require_space(out, options.max_surfels)

        page, share, figures = ProgressPage(out, f"Fit of surfels to {path.name}") if view else None, 0.0, ""

        def fitted(iteration: int, iterations: int, loss: float, psnr: float | None, surfels: int) -> None:
            nonlocal share, figures
            quality = "" if psnr is None else f"  {psnr:.2f} dB"
            share, figures = (
                iteration / iterations,
                f"{iteration}/{iterations}  loss {loss:.5f}{quality}  {surfels:,} surfels",
            )
            progress("fitting", share, figures)
            if page is not None:
                page.add("fitting", loss)

        def watched(now: Now) -> None:
            if page is not None:
                page.update(share, figures, lambda: _pairs(views, *now()))

        progress("fitting", 0.0, "getting ready")
        registration = register(source.views, source.mesh, source.up)
        views = registered(source.views, registration)
        require_fitting(source, registration)
        often = replace(options, checkpoint_every=_CHECKPOINT_EVERY)
        result = fit(views, source.mesh, often, folder=out, resume=resume, progress=fitted, watch=watched)
        if page is not None:
            page.end(figures, lambda: _pairs(views, result.surfels, result.camera_offset))
        write_fit_results(
            out,
            source.path,
            source.mesh_path,
            views,
            source.up,
            options,
            result,
            registration,
            lambda share: progress("drawing", share, "turntable"),
        )
        return result


def read_source(path: Path, mesh_path: Path | None) -> Source:
    """Read and check images, poses and mesh.

    Args:
        path: A capture, or a folder with `transforms.json` and images, or that file.
        mesh_path: The object's mesh; None for that of the capture.

    Returns:
        Everything that the fit needs.

    Raises:
        InputError: One of the files is missing or refused.
        ParameterError: The folder is no capture, and there is no mesh.
    """
    if is_file(path / CAPTURE_FILE):
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


def require_fitting(source: Source, registration: Registration) -> None:
    """Require a mesh whose outlines are where the masks are.

    Args:
        source: Images, given poses and mesh.
        registration: Where the masks have the object.

    Raises:
        InputError: Outline and mask overlap too little in too many views, or far from the given pose or size alone.
    """
    views = registered(source.views, registration)
    found = [_overlap(view, source.mesh) for view in views]
    judged = [(view.name, overlap) for view, overlap in zip(source.views, found, strict=True) if overlap is not None]
    poor = [(name, overlap) for name, overlap in judged if overlap.iou < _FITS]
    if len(poor) > _EXCEPT * len(judged):
        name, worst = min(poor, key=lambda one: one[1].iou)
        raise InputError(
            source.mesh_path,
            value=f"a mesh that misses the masks in {len(poor)} of {len(judged)} views; {name}: {worst.words()}",
            allowed=f"{_FITS:.2f} in {1.0 - _EXCEPT:.0%} of them; check object, unit, scale, object.X_WO and poses",
        )
    if registration.shift > _NEAR:
        raise InputError(
            source.mesh_path,
            value=f"a mesh that is {1e3 * registration.shift:.0f} mm from where the masks show it, "
            f"turned by {np.degrees(registration.turn):.0f} deg",
            allowed=f"{1e3 * _NEAR:.0f} mm at most; check the origin of the mesh and object.X_WO",
        )
    size = measure_size(views, source.mesh, source.up)
    if abs(np.log(size.scale)) > np.log(1.0 + _AS_LARGE) or abs(size.height) > _AS_HIGH:
        raise InputError(
            source.mesh_path,
            value=f"a mesh that the masks show {size.words()}",
            allowed=f"{_AS_LARGE:.0%} and {1e3 * _AS_HIGH:.0f} mm; check scale and origin of the mesh and object.X_WO",
        )


def _overlap(view: View, mesh: trimesh.Trimesh) -> Agreement | None:
    """Agreement of a mesh's outline with the mask of a view; None where they have too few pixels to tell."""
    outline, mask = silhouette(mesh, view.camera, view.X_CO), view.mask.numpy() > 0
    if outline is None or not outline.any():
        return Agreement(0.0, float("inf"), (0.0, 0.0))
    return compare(outline, mask)


def _pairs(views: list[View], surfels: Surfels, offset: tuple[float, float]) -> list[Pair]:
    """Return some of the views, each with its rendering: the surroundings of the object in them."""
    pairs = []
    for k in evenly(len(views), _SHOWN):
        view = views[k]
        with torch.no_grad():
            color = render(surfels, view.camera.shifted(offset), view.X_CO, full=False).color[0].numpy()
        box = box_around(view.mask.numpy() > 0, 0.1, 1)
        pairs.append((view.image.numpy()[box], color[box]))
    return pairs


def _require_space(out: Path, max_surfels: int) -> None:
    """Raise InputError where the results would not fit the disk."""
    needed, free = _SPACE + _SPACE_PER_SURFEL * max_surfels, shutil.disk_usage(out).free
    if free < needed:
        raise InputError(out, value=f"{free / 1e6:.0f} MB of free space", allowed=f"{needed / 1e6:.0f} MB or more")
