# SPDX-License-Identifier: MIT
"""The files of a fit: surfels.ply, align.json, align.png, view.html and turntable.mp4."""

import hashlib
import json
import warnings
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path

import numpy as np
import torch

from pinwm_drake.documents import Entry, read_json
from pinwm_drake.errors import InputError
from pinwm_drake.files import replacing
from pinwm_drake.provenance import timestamp, versions
from pinwm_drake.reading.contents import read_bytes
from pinwm_drake.rendering.fit_options import FitOptions
from pinwm_drake.rendering.fitting import FitResult
from pinwm_drake.rendering.ply import write_ply
from pinwm_drake.rendering.registration import Registration
from pinwm_drake.rendering.render import render
from pinwm_drake.rendering.views import View
from pinwm_drake.report.figures.align import Strip, align_figure
from pinwm_drake.report.surfels.page import write_surfel_page
from pinwm_drake.report.surfels.turntable import FRAME_RATE, write_turntable
from pinwm_drake.spatial.poses import Pose, identity
from pinwm_drake.twin.twin import SURFELS_FILE

ALIGN_FILE, FIGURE_FILE, PAGE_FILE, VIDEO_FILE = "align.json", "align.png", "view.html", "turntable.mp4"
FILES = (SURFELS_FILE, ALIGN_FILE, FIGURE_FILE, PAGE_FILE, VIDEO_FILE)
_SHA256 = "surfels_sha256"
_STRIPS = 3
_TURN = 4  # s
_LARGEST_TURNTABLE = 480  # px; smaller where the images are


def write_fit_results(
    out: Path,
    source: Path,
    mesh_path: Path,
    views: list[View],
    up: np.ndarray,
    options: FitOptions,
    result: FitResult,
    registration: Registration,
    report: Callable[[float], None] = lambda share: None,
) -> None:
    """Write `FILES` into an existing folder, the surfels first.

    Args:
        out: The folder.
        source, mesh_path: Where the images and the mesh came from.
        views: All views of the fit.
        up: (3,), unit, object frame: upwards in the pictures.
        options, result: Options and result of the fit.
        registration: Where the views have the object, against the pose that was given.
        report: Called with the share of the turntable that is drawn.

    Raises:
        InputError: A file cannot be written.
    """
    surfels = result.surfels
    write_ply(out / SURFELS_FILE, surfels)
    with replacing(out / ALIGN_FILE) as temporary:
        record = _record(source, mesh_path, options, result, registration)
        record[_SHA256] = hashlib.sha256(read_bytes(out / SURFELS_FILE)).hexdigest()
        temporary.write_text(json.dumps(record, indent=1) + "\n")
    title = f"{source.resolve().name}: {surfels.num_surfels:,} surfels"
    _draw(out / FIGURE_FILE, views, result, title)
    write_surfel_page(out / PAGE_FILE, surfels, title=title, up=up)
    smallest = min(min(view.camera.width, view.camera.height) for view in views)
    size = max(2 * (min(_LARGEST_TURNTABLE, smallest) // 2), 16)
    write_turntable(out / VIDEO_FILE, surfels, size=size, num_frames=_TURN * FRAME_RATE, up=up, report=report)


def read_offset(path: Path) -> tuple[float, float]:
    """Return the camera's offset [px] that a fit found, from its `align.json`, beside which its surfels lie.

    Raises:
        InputError: The file cannot be used, or the surfels are those of another fit.
    """
    document = read_json(path)
    _check_surfels(document)
    x, y = document["camera_offset"].numbers(2).tolist()
    return x, y


def _check_surfels(document: Entry) -> None:
    """Compare the surfels beside an `align.json` with its SHA-256; warn where it has none."""
    expected = document.find(_SHA256)
    if expected is None:
        warnings.warn(f"{document.path}: no {_SHA256}: surfels of another fit would not be noticed", stacklevel=3)
        return
    path = document.path.with_name(SURFELS_FILE)
    found = hashlib.sha256(read_bytes(path)).hexdigest()
    if expected.text() != found:
        allowed = f"{expected.text()[:12]}, as {document.path.name} beside it has it; copy both of one fit"
        raise InputError(path, value=f"SHA-256 {found[:12]}", allowed=allowed)


def read_registration(path: Path) -> Pose:
    """Return the pose X_OS of the object that the static views show, against the one that was given, from `align.json`.

    A file of an older release tells no registration, which is that of the pose that was given.

    Raises:
        InputError: The file cannot be used.
    """
    found = read_json(path).find("object")
    if found is None:
        return identity()
    entry = found["X_OS"]
    q, p = torch.from_numpy(entry["q"].numbers(4)), torch.from_numpy(entry["p"].numbers(3))
    return Pose(q / q.norm(), p)


def _record(
    source: Path, mesh_path: Path, options: FitOptions, result: FitResult, registration: Registration
) -> dict[str, object]:
    """Figures and provenance; dB, s, px, m and rad."""
    history = result.history
    return {
        "schema_version": 1,
        "source": str(source.resolve()),
        "mesh": str(mesh_path.resolve()),
        "created": timestamp(),
        "num_surfels": result.surfels.num_surfels,
        "seconds": round(result.seconds, 2),
        "final_loss": float(history.loss[-1]),
        "psnr": {"fitted": _mean(result.psnr_train), "held_out": _mean(result.psnr_test)},
        "views": {"fitted": result.psnr_train, "held_out": result.psnr_test},
        "held_out_curve": {"iteration": history.test_iteration.tolist(), "psnr": history.test_psnr.tolist()},
        "camera_offset": list(result.camera_offset),
        "object": {
            "X_OS": {"q": registration.X_OS.q.tolist(), "p": registration.X_OS.p.tolist()},
            "shift": round(registration.shift, 6),
            "turn": round(registration.turn, 6),
            "differing": [round(share, 5) for share in registration.differing],
        },
        "options": asdict(options),
        "versions": versions(),
    }


def _mean(values: dict[str, float]) -> float | None:
    return float(np.mean(list(values.values()))) if values else None


def _draw(path: Path, views: list[View], result: FitResult, title: str) -> None:
    history, shown = result.history, result.psnr_test or result.psnr_train
    # One point for each time that all views were seen.
    epoch = len(result.psnr_train)
    parts = [np.array_split(values, max(len(history.psnr) // epoch, 1)) for values in (history.iteration, history.psnr)]
    curves = [("fitted", np.array([(iteration[-1], psnr.mean()) for iteration, psnr in zip(*parts, strict=True)]))]
    if len(history.test_psnr):
        curves.append(("held out", np.stack((history.test_iteration, history.test_psnr), axis=-1)))
    kinds = (("fitted", result.psnr_train), ("held-out", result.psnr_test))
    words = [f"{_mean(values):.2f} dB on {len(values)} {kind} views" for kind, values in kinds if values]
    strips = []
    for view in [view for view in views if view.name in shown][:_STRIPS]:
        with torch.no_grad():
            color = render(result.surfels, view.camera.shifted(result.camera_offset), view.X_CO, full=False).color[0]
        strips.append(Strip(Path(view.name).name, view.image.numpy(), color.numpy(), shown[view.name]))
    loss = np.stack((history.iteration, history.loss), axis=-1)
    title = f"{title}; {', '.join(words)}"
    align_figure(path, loss=loss, window=epoch, psnr=curves, strips=strips, title=title)
