"""The page of the main demonstration: one file that loads nothing from anywhere."""

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import astuple, dataclass
from pathlib import Path

import numpy as np
import torch

from pinwm_drake.demo.options import DemoOptions
from pinwm_drake.demo.policy import Performance
from pinwm_drake.demo.stages import Stages
from pinwm_drake.models import policy_path
from pinwm_drake.rendering.fitting import FitResult
from pinwm_drake.rendering.render import render
from pinwm_drake.rendering.views import View
from pinwm_drake.report import page
from pinwm_drake.report.surfels.turntable import to_bytes
from pinwm_drake.report.twin.comparison_frames import Shot
from pinwm_drake.report.twin.score import PoseErrors
from pinwm_drake.threads import available
from pinwm_drake.twin.twin import Twin

PAGE_FILE = "index.html"
_VIEWS = 4  # static views that are shown


@dataclass(frozen=True, eq=False)
class DemoPush:
    """A push of the capture as the camera saw it and as the twin has it.

    Attributes:
        name: Of the episode.
        shots: The frames.
        errors: Of the poses; None where the truth is not known.
    """

    name: str
    shots: list[Shot]
    errors: PoseErrors | None


@dataclass(frozen=True, eq=False)
class DemoResult:
    """Everything that the page shows.

    Attributes:
        options: Capture, policy and budgets.
        views: Static views of the object.
        fit: The surfels.
        twin: The twin.
        truth: True values of the twin's parameters, by name.
        identified: The push that the twin was identified from.
        predicted: The push that it was not.
        performances: The policy in the twin and in the hydroelastic plant.
        stages: Times of the stages.
    """

    options: DemoOptions
    views: list[View]
    fit: FitResult
    twin: Twin
    truth: dict[str, float]
    identified: DemoPush
    predicted: DemoPush
    performances: list[Performance]
    stages: Stages


def write_page(out: Path, result: DemoResult, films: Mapping[str, Sequence[page.Frame]]) -> None:
    """Writes the page.

    Args:
        out: Folder of the results, which links are relative to.
        result: What it shows.
        films: Frames by name, as `write_films` returns them.

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
    """The main results: name, figure and more words of each."""
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
    """Some static views, held-out ones first, and the surfels from the same place."""
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
    """Some of the images that the policy saw."""
    record = performance.record
    words = (f"{performance.engine}, action {step}" for step in record.at.tolist())
    return list(zip(record.views, words, strict=True))


def _relative(path: Path, out: Path) -> str:
    return Path(os.path.relpath(path.resolve(), out.resolve())).as_posix() + "/"
