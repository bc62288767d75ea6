"""The page of the main demonstration: one file that loads nothing from anywhere."""

import os
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import torch

from pinwm_drake.capture.ground_truth import GROUND_TRUTH_FILE
from pinwm_drake.demo.films import FOLDER, Frames
from pinwm_drake.demo.policy import Performance
from pinwm_drake.demo.result import DemoResult
from pinwm_drake.files import replacing
from pinwm_drake.models import policy_path
from pinwm_drake.rendering.render import render
from pinwm_drake.report.embed import picture_uri
from pinwm_drake.report.evaluation.film_strip import film_player
from pinwm_drake.report.page import fill_template, paragraph, section, table, text
from pinwm_drake.report.twin.estimates_table import estimates_table
from pinwm_drake.report.twin.score import PoseErrors
from pinwm_drake.threads import available
from pinwm_drake.twin.twin import Estimate

PAGE_FILE = "index.html"
_VIEWS = 4  # static views that are shown
_OWN = """pinwm capture check mycapture                       # your images, poses and pushes: what is wrong with them
pinwm identify mycapture out/mytwin                 # surfels, then friction, mass properties, restitution
pinwm report out/mytwin                             # out/mytwin/report.html
pinwm predict out/mytwin mycapture/episodes/0001 -o out/predicted.csv --video out/predicted.mp4
pinwm train out/mytwin -o out/mypolicy              # a policy that pushes your object
pinwm evaluate out/mypolicy --engine hydroelastic -o out/evaluation"""


def write_page(out: Path, result: DemoResult, films: Mapping[str, Frames]) -> None:
    """Writes the page.

    Args:
        out: Folder of the results, which links are relative to.
        result: What it shows.
        films: Frames by name, as `write_films` returns them.

    Raises:
        InputError: The file cannot be written.
    """
    name = result.capture.object.name
    parts = {
        "title": text(f"{name}: from images to a twin to a policy"),
        "about": text(_about(result)),
        "notices": "",
        "body": "\n".join((_tiles(result), *_sections(out, result, films))),
    }
    with replacing(out / PAGE_FILE) as temporary:
        temporary.write_text(fill_template(parts), encoding="utf-8")


def _about(result: DemoResult) -> str:
    frames = len(result.identified.shots)
    made = result.twin.provenance.get("created", "")
    return (
        f"Made by pinwm demo, {made}, from {len(result.views)} static views and the {frames} frames of one push. "
        "The capture is a simulation in Drake's hydroelastic plant, so that the truth is known; it is used for "
        "scores alone."
    )


def _tiles(result: DemoResult) -> str:
    """The main results as a row of figures."""
    friction, errors = result.twin.theta["friction_floor"], result.predicted.errors
    tiles = [
        ("friction of the floor", f"{friction.value:.4f}", _certainty(friction, result.truth.get("friction_floor")))
    ]
    if errors is not None:
        millimetres, degrees = 1e3 * errors.position, np.degrees(errors.rotation)
        tiles.append(
            (
                "second push, predicted",
                f"{millimetres.mean():.1f} mm",
                f"off on average, {millimetres.max():.1f} mm and {degrees.max():.1f}° at most",
            )
        )
    for performance in result.performances:
        outcome = performance.record.result
        where = f"{1e3 * outcome.distance:.1f} mm and {np.degrees(outcome.angle):.1f}° from the goal"
        reached = "reached" if outcome.success else "missed"
        tiles.append((f"policy, {performance.engine}", f"goal {reached}", f"{outcome.steps} actions; {where}"))
    cells = "".join(
        f'<div class="tile"><span>{text(name)}</span><b>{text(value)}</b><span>{text(more)}</span></div>'
        for name, value, more in tiles
    )
    return f'<div class="tiles">{cells}</div>'


def _certainty(estimate: Estimate, truth: float | None) -> str:
    parts = [] if estimate.interval is None else ["95 %: {:.4f} to {:.4f}".format(*estimate.interval)]
    return "; ".join([*parts, *([] if truth is None else [f"true: {truth:g}"])])


def _sections(out: Path, result: DemoResult, films: Mapping[str, Frames]) -> list[str]:
    fitted = result.fit
    quality = f"{np.mean(list(fitted.psnr_train.values())):.1f} dB on {len(fitted.psnr_train)} fitted views"
    if fitted.psnr_test:
        quality += f", {np.mean(list(fitted.psnr_test.values())):.1f} dB on {len(fitted.psnr_test)} held-out ones"
    names = "<span>camera</span><span>twin</span>"
    return [
        section(
            "1. Align: the object's appearance",
            paragraph(
                f"{fitted.surfels.num_surfels:,} surfels, fitted to the static views: {quality}. "
                "Above what the camera saw, below the surfels.",
                "lead",
            ),
            _strips(result),
        ),
        section(
            "2. Identify: physics from one push",
            paragraph(
                f"Friction and mass properties for which physics and renderer reproduce the video of episode "
                f"{result.identified.name}. {_score(result.identified.errors)}",
                "lead",
            ),
            _player(films["identified"], names),
            "<h3>Parameters, with 95 % intervals and the truth</h3>",
            estimates_table(result.twin.theta, result.truth),
            paragraph(
                "A parameter that is not identifiable has hardly any influence on these images: its value is what it "
                f"was at the start or what the capture says. The truth is that of {GROUND_TRUTH_FILE} in the capture."
            ),
        ),
        section(
            "3. Predict: a second push",
            paragraph(
                f"Of episode {result.predicted.name} the twin is given the pusher's motion and where the object "
                f"starts, nothing else. {_score(result.predicted.errors)}",
                "lead",
            ),
            _player(films["predicted"], names),
        ),
        section(
            "4. Act: the policy that ships",
            paragraph(
                f"The policy {result.options.policy} sees images of {_seen(result.performances)} and moves the pusher. "
                "On the left in the twin made above, on the right in Drake's hydroelastic plant, from the same start; "
                "the goal is outlined in green.",
                "lead",
            ),
            _player(films["policy"], "".join(f"<span>{text(one.engine)}</span>" for one in result.performances)),
            *(_views(performance) for performance in result.performances),
        ),
        section("For an object of your own", *_next()),
        section("Files", _files(out, result)),
        section("Seconds of each stage", _costs(result)),
    ]


def _score(errors: PoseErrors | None) -> str:
    return "" if errors is None else f"Against the truth: {errors.words()}."


def _player(frames: Frames, names: str) -> str:
    return f'<div class="two">{film_player(frames, names)}</div>'


def _strips(result: DemoResult) -> str:
    """Some static views, held-out ones first, and the surfels from the same place."""
    held = [view for view in result.views if view.name in result.fit.psnr_test]
    shown = (held or result.views)[:_VIEWS]
    rows: list[list[str]] = [[], []]
    for view in shown:
        camera = view.camera.shifted(result.fit.camera_offset)
        with torch.no_grad():
            rendered = render(result.fit.surfels, camera, view.X_CO, full=False).color[0].numpy()
        for row, picture, words in zip(rows, (view.image.numpy(), rendered), ("camera", "surfels"), strict=True):
            pixels = (255 * np.clip(picture, 0, 1) + 0.5).astype(np.uint8)
            row.append(f'<img src="{picture_uri(pixels)}" alt="{text(f"{words}, {Path(view.name).name}")}">')
    return _grid("".join(rows[0] + rows[1]), len(shown))


def _seen(performances: Sequence[Performance]) -> str:
    height, width = performances[0].record.views.shape[1:3]
    return f"{width} by {height} px"


def _views(performance: Performance) -> str:
    """Some of the images that the policy saw."""
    record = performance.record
    if not len(record.views):
        return ""
    cells = "".join(
        f'<img src="{picture_uri(view)}" alt="{text(f"{performance.engine}, action {step}")}">'
        for view, step in zip(record.views, record.at.tolist(), strict=True)
    )
    return f"<h3>What the policy saw: {text(performance.engine)}</h3>{_grid(cells, len(record.views))}"


def _grid(cells: str, columns: int) -> str:
    style = f"grid-template-columns: repeat({columns}, minmax(0, 1fr))"
    return f'<div class="strips" style="{style}">{cells}</div>'


def _next() -> list[str]:
    return [
        paragraph(
            "Take some 20 images of the object at rest with known camera poses, and film a push or two while the "
            "pusher's motion is logged. Images posed by nerfstudio or COLMAP come in by pinwm capture import; pinwm "
            "capture simulate makes a stand-in. Then type:",
            "lead",
        ),
        f"<pre>{text(_OWN)}</pre>",
        paragraph("On two cores identify takes some minutes, and the training hours."),
    ]


def _files(out: Path, result: DemoResult) -> str:
    """Links, relative to the page."""
    options = result.options
    rows = [
        ("twin/report.html", "report of the twin: parameters, motion, course of the identification"),
        ("twin/view.html", "the surfels, to be turned with the mouse"),
        ("twin/twin.yaml", "the twin itself; its folder is what other commands take"),
        (f"prediction/{result.predicted.name}.csv", "poses of the predicted push"),
        *((f"{FOLDER}/{name}.mp4", f"film: {name}") for name in ("identified", "predicted", "policy")),
        (_relative(options.capture, out), "the capture"),
        (_relative(policy_path(options.policy), out), "the policy's bundle"),
    ]
    cells = [(f'<a href="{text(href)}">{text(href)}</a>', text(words)) for href, words in rows]
    return table([("file", "key"), ("", "wide")], cells)


def _relative(path: Path, out: Path) -> str:
    return Path(os.path.relpath(path.resolve(), out.resolve())).as_posix() + "/"


def _costs(result: DemoResult) -> str:
    """Time of each stage and of all."""
    costs = result.costs
    longest = max(cost.seconds for cost in costs)
    rows = [
        (
            text(cost.name),
            f"{cost.seconds:.1f} s",
            f"{cost.cpu_seconds:.1f} s",
            f'<span class="bar" style="width: {100 * cost.seconds / longest:.1f}%"></span>',
        )
        for cost in costs
    ]
    words = (
        f"In all {result.seconds:.0f} s, in which {available()} cores worked for "
        f"{sum(cost.cpu_seconds for cost in costs):.0f} s. The physics is compiled beside the alignment by a second "
        "process, which has nothing to compile in a second run."
    )
    header = [("stage", "key"), ("wall time", "number"), ("time of the cores", "number"), ("", "wide")]
    return table(header, rows) + paragraph(words)
