# SPDX-License-Identifier: MIT
"""The page of the main demonstration, which loads nothing from anywhere, and its films, which are files too."""

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import astuple, dataclass
from pathlib import Path

import numpy as np
import torch

from pinwm_drake.demo.options import DemoOptions
from pinwm_drake.demo.policy import Performance
from pinwm_drake.demo.stages import Report, Stages
from pinwm_drake.files import prepare_folder
from pinwm_drake.models import policy_path
from pinwm_drake.rendering.fitting import FitResult
from pinwm_drake.rendering.render import render
from pinwm_drake.rendering.views import View
from pinwm_drake.report import page
from pinwm_drake.report.style import evenly
from pinwm_drake.report.surfels.turntable import to_bytes
from pinwm_drake.report.twin.comparison_frames import Shot
from pinwm_drake.report.twin.score import PoseErrors
from pinwm_drake.report.video import write_video
from pinwm_drake.threads import available
from pinwm_drake.twin.twin import Twin

PAGE_FILE, FOLDER = "index.html", "films"
_VIEWS = 4  # static views that are shown
_GAP = 4  # px, white, between two pictures of a film
_MOST = 60  # frames of the policy's film


@dataclass(frozen=True, eq=False)
class DemoPush:
    """A push of the capture as the camera saw it and as the twin has it."""

    name: str  # of the episode
    shots: list[Shot]
    errors: PoseErrors | None  # None where the truth is not known


@dataclass(frozen=True, eq=False)
class DemoResult:
    """Everything that the page shows but the films."""

    options: DemoOptions
    views: list[View]
    fit: FitResult
    twin: Twin
    truth: dict[str, float]
    identified: DemoPush
    predicted: DemoPush
    performances: list[Performance]  # in the twin and in the hydroelastic plant
    stages: Stages


def write_page(out: Path, result: DemoResult, films: Mapping[str, Sequence[page.Frame]]) -> None:
    """Write the page into the folder of the results, with films as `write_films` returns them.

    Raises:
        InputError: The file cannot be written.
    """
    fitted = result.fit
    quality = f"{np.mean(list(fitted.psnr_train.values())):.1f} dB on {len(fitted.psnr_train)} fitted views"
    if fitted.psnr_test:
        quality += f", {np.mean(list(fitted.psnr_test.values())):.1f} dB on {len(fitted.psnr_test)} held-out ones"
    page.write_page(
        out / PAGE_FILE,
        "demo/page.html",
        result=result,
        tiles=list(_tiles(result)),
        quality=quality,
        views=_views(result),
        films=films,
        seen=_seen,
        capture=_relative(result.options.capture, out),
        policy=_relative(policy_path(result.options.policy), out),
        costs=[astuple(cost) for cost in result.stages.costs],
        cores=available(),
    )


def _tiles(result: DemoResult) -> Iterator[tuple[str, str, str]]:
    friction, truth = result.twin.theta["friction_floor"], result.truth.get("friction_floor")
    words = [] if friction.interval is None else ["95 %: {:.4f} to {:.4f}".format(*friction.interval)]
    words += [] if truth is None else [f"true: {truth:g}"]
    yield "friction of the floor", f"{friction.value:.4f}", "; ".join(words)
    if (errors := result.predicted.errors) is not None:
        millimetres, degrees = 1e3 * errors.position, np.degrees(errors.rotation)
        most = f"off on average, {millimetres.max():.1f} mm and {degrees.max():.1f}° at most"
        yield "second push, predicted", f"{millimetres.mean():.1f} mm", most
    for performance in result.performances:
        outcome = performance.record.result
        where = f"{1e3 * outcome.distance:.1f} mm and {np.degrees(outcome.angle):.1f}° from the goal"
        reached = "goal reached" if outcome.success else "goal missed"
        yield f"policy, {performance.engine}", reached, f"{outcome.steps} actions; {where}"


def _views(result: DemoResult) -> list[list[tuple[np.ndarray, str]]]:
    held = [view for view in result.views if view.name in result.fit.psnr_test]
    seen, rendered = [], []
    for view in (held or result.views)[:_VIEWS]:
        camera, name = view.camera.shifted(result.fit.camera_offset), Path(view.name).name
        with torch.no_grad():
            color = render(result.fit.surfels, camera, view.X_CO, full=False).color[0]
        seen.append((to_bytes(view.image), f"camera, {name}"))
        rendered.append((to_bytes(color), f"surfels, {name}"))
    return [seen, rendered]


def _seen(performance: Performance) -> list[tuple[np.ndarray, str]]:
    record = performance.record
    words = (f"{performance.engine}, action {step}" for step in record.at.tolist())
    return list(zip(record.views, words, strict=True))


def _relative(path: Path, out: Path) -> str:
    return Path(os.path.relpath(path.resolve(), out.resolve())).as_posix() + "/"


def write_films(
    out: Path, pushes: Sequence[DemoPush], performances: Sequence[Performance], report: Report
) -> dict[str, list[page.Frame]]:
    """Draws the films of both pushes and of the policy, and writes each as MP4; the frames of each by its name.

    Raises:
        InputError: A file cannot be written.
    """
    films = {name: _push_frames(push) for name, push in zip(("identified", "predicted"), pushes, strict=True)}
    films["policy"] = _policy_frames(performances, report)
    folder = prepare_folder(out / FOLDER)
    for name, frames in films.items():
        t = [frame[0] for frame in frames]
        rate = (len(t) - 1) / (t[-1] - t[0]) if t[-1] > t[0] else 1.0
        height, width = frames[0][1].shape[:2]
        write_video(folder / f"{name}.mp4", (frame[1] for frame in frames), rate=rate, size=(width, height))
    return films


def _push_frames(push: DemoPush) -> list[page.Frame]:
    frames, errors = [], push.errors
    for k, shot in enumerate(push.shots):
        words = f"t = {shot.t:.2f} s"
        if errors is not None and len(errors.t) == len(push.shots):
            millimetres, degrees = 1e3 * errors.position[k], np.degrees(errors.rotation[k])
            words += f"; {millimetres:.1f} mm and {degrees:.1f}° from the truth"
        frames.append((shot.t, _beside(shot.panels[:2]), words))
    return frames


def _policy_frames(performances: Sequence[Performance], report: Report) -> list[page.Frame]:
    """Return the episodes side by side from their first action on; one that has ended stays as it is."""
    frames = []
    steps = evenly(1 + max(performance.record.last for performance in performances), _MOST)
    for number, step in enumerate(steps):
        pictures = [performance.film.picture(performance.record, step) for performance in performances]
        words = "; ".join(_place(performance, step) for performance in performances)
        frames.append((step * performances[0].horizon, _beside(pictures), words))
        report((number + 1) / len(steps), f"action {step}")
    return frames


def _beside(pictures: Sequence[np.ndarray]) -> np.ndarray:
    """Pictures of one size side by side, of even width and height."""
    height, width = (length // 2 * 2 for length in pictures[0].shape[:2])
    parts = [np.pad(one[:height, :width], ((0, 0), (0, _GAP), (0, 0)), constant_values=255) for one in pictures]
    return np.hstack(parts)[:, :-_GAP]


def _place(performance: Performance, step: int) -> str:
    record = performance.record
    ended = f", {record.result.outcome}" if step >= record.last else ""
    return f"{performance.engine}: action {min(step, record.last)}{ended}"
