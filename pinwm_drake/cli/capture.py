# SPDX-License-Identifier: MIT
"""`pinwm capture`: check, refine and simulate captures, add episodes, and import data of other formats."""

import re
import warnings
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import typer
from rich.console import Console
from rich.markup import escape

from pinwm_drake.cli.command import add_command
from pinwm_drake.cli.console import Show, say, stages_bar
from pinwm_drake.experiments.requests.captures import (
    AddEpisodeRequest,
    CheckRequest,
    ColmapRequest,
    NerfstudioRequest,
    PinwmRequest,
    RefineRequest,
)
from pinwm_drake.systems.runs.capture_options import SimulateCaptureRequest

if TYPE_CHECKING:
    from rich.table import Table

    from pinwm_drake.capture.check import CheckResult
    from pinwm_drake.capture.checks.findings import Problem

_IMAGES = {".png", ".jpg", ".jpeg"}
_NUMBER = re.compile(r"[-+]?\d[\d.]*(e[-+]?\d+)?")
_STYLES = {"error": "bold red", "warning": "yellow"}


def check(request: CheckRequest) -> None:
    """List everything that is wrong with a capture.

    Exits with 1 where something makes it unusable. Problems with one cause share a row.
    """
    from pinwm_drake.capture.check import check_capture

    console, folder, done = Console(), request.folder, 0
    images = sum(path.suffix.lower() in _IMAGES and "masks" not in path.parts for path in folder.rglob("*"))
    with stages_bar(transient=True) as show:

        def progress(part: str) -> None:
            nonlocal done
            show("checking", min(done / (images + 1), 1.0), part)
            done += 1

        result = check_capture(folder, progress)
    if result.problems:
        console.print(_table(folder, result, request.every))
    console.print(f"{folder}: {_summary(result)}", style=_colour(result), highlight=False, markup=False, soft_wrap=True)
    if result.errors:
        raise SystemExit(1)


def refine(request: RefineRequest) -> None:
    """Fit the mesh of a capture to its masks, in a copy.

    It mends a mesh that is a few millimetres wrong.
    """
    from pinwm_drake.capture.refine import refine_capture

    with stages_bar() as show:
        found = refine_capture(
            request.folder, request.out, progress=lambda share, loss: show("fitting", share, f"misfit {loss:.2g}")
        )
    say(
        f"masks differ by {100 * found.after:.1f} % of the object's pixels instead of {100 * found.before:.1f} %; "
        f"vertices moved by {1e3 * found.moved.mean():.1f} mm on average, {1e3 * found.moved.max():.1f} mm at most"
    )
    say(f"wrote {request.out}")


def simulate(request: SimulateCaptureRequest) -> None:
    """Make a capture in Drake, in place of a robot and a camera."""
    from pinwm_drake.systems.runs.simulated_capture import simulate_capture

    with stages_bar() as progress:
        simulate_capture(request.options, request.out, progress=progress)
    say(f"wrote {request.out}")


def _summary(result: "CheckResult") -> str:
    """Numbers of problems, views and images, in one line."""
    episodes, images = len(result.images), sum(result.images.values())
    parts = (
        _count(result.errors, "error"),
        _count(result.warnings, "warning"),
        _count(result.views, "static view"),
        _count(episodes, "episode"),
        _count(images, "image"),
    )
    return ", ".join(parts)


def _table(folder: Path, result: "CheckResult", every: bool) -> "Table":
    """Table of the problems: errors before warnings, each with its place; those with one cause share a row."""
    from rich.table import Table

    table = Table("", title="Problems", show_lines=True)
    for name in ("where", "found", "allowed"):
        table.add_column(name, overflow="fold")
    for problems in _by_cause(result.problems, every):
        table.add_row(*_row(folder, problems))
    return table


def _by_cause(problems: "Sequence[Problem]", every: bool) -> "list[list[Problem]]":
    """Problems with one cause together: what was found and is allowed is the same, but for numbers; or each alone."""
    groups: dict[object, list[Problem]] = {}
    for problem in sorted(problems, key=lambda problem: problem.severity):
        error = problem.problem
        words = (_NUMBER.sub("0", str(text)) for text in (error.value, error.allowed))
        groups.setdefault(len(groups) if every else (problem.severity, *words), []).append(problem)
    return list(groups.values())


def _row(folder: Path, problems: "Sequence[Problem]") -> list[str]:
    first, style = problems[0], _STYLES[problems[0].severity]
    error, more = first.problem, len(problems) - 1
    where = _short(folder, error.path) + ("" if error.row is None else f", row {error.row}")
    found = "" if error.value is None else str(error.value)
    if more:
        places = len({one.problem.path for one in problems})
        found += f"\n{more} more like this{'' if places == 1 else f', in {places} files'}; --all shows them"
    return [f"[{style}]{first.severity}[/]", escape(where), escape(found), escape(error.allowed)]


def _short(folder: Path, path: str) -> str:
    """Path relative to the capture's folder where it lies in it, else as it is."""
    try:
        return str(Path(path).relative_to(folder))
    except ValueError:
        return path


def _colour(result: "CheckResult") -> str:
    return _STYLES["error"] if result.errors else _STYLES["warning"] if result.warnings else "bold green"


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}" + ("" if number == 1 else "s")


def nerfstudio(request: NerfstudioRequest) -> None:
    """Import posed images in nerfstudio's or NeRF's layout."""
    from pinwm_drake.capture.importers.nerfstudio import import_nerfstudio

    scenery, similarity = request.scenery.read(), request.world.read()
    with stages_bar(transient=True) as show:
        views = import_nerfstudio(request.source, request.out, scenery, similarity, report=partial(_import, show))
    _report(request.out, f"{views} static views")


def colmap(request: ColmapRequest) -> None:
    """Import a COLMAP model and its images.

    Images of cameras with distortion are undistorted.
    """
    from pinwm_drake.capture.importers.colmap import import_colmap

    scenery, similarity = request.scenery.read(), request.world.read()
    with stages_bar(transient=True) as show:
        views = import_colmap(
            request.source,
            request.out,
            scenery,
            similarity,
            images=request.images,
            masks=request.masks,
            report=partial(_import, show),
        )
    _report(request.out, f"{views} static views")


def pinwm(request: PinwmRequest) -> None:
    """Import a data set in the layout of PIN-WM's authors."""
    from pinwm_drake.capture.importers.pinwm import import_pinwm

    with stages_bar(transient=True) as show:
        files = import_pinwm(
            request.source,
            request.out,
            request.scenery.read(),
            pusher_height=request.pusher_height,
            camera=request.camera,
            static=request.static,
            report=partial(_import, show),
        )
    _report(request.out, ", ".join(f"episode {k:04} from {file}" for k, file in enumerate(files)))


def add_episode(request: AddEpisodeRequest) -> None:
    """Add an episode from a film and a log of the pusher.

    Finds the offset between their clocks, keeps what both cover, and tells what it drops.
    """
    import math

    from pinwm_drake.station.episode import Sources
    from pinwm_drake.station.episode import add_episode as add

    given = {name: value for name, value in vars(request).items() if name not in ("folder", "name")}
    given["start"] = -math.inf if request.start is None else request.start
    given["end"] = math.inf if request.end is None else request.end
    with stages_bar(transient=True) as show:
        added = add(
            request.folder, Sources(**given), name=request.name, report=lambda what, share: show(what, share, "")
        )
    clock = added.clock
    for note in clock.notes:
        say(note)
    low, high = (1e3 * (end - clock.offset) for end in clock.interval)
    say(f"clock: the log's time is the film's {clock.offset:+.4f} s, {low:+.1f} to {high:+.1f} ms with 95 %")
    if not added.masked:
        warnings.warn(f"{added.folder}: no masks; identify refuses it until masks/ has one of each image", stacklevel=1)
    _report(added.folder, f"{added.images} images", request.folder)


def _import(show: Show, share: float) -> None:
    show("importing", share, "images")


def _report(out: Path, contents: str, capture: Path | None = None) -> None:
    say(f"wrote {out}: {contents}")
    say(f"check it with: pinwm capture check {capture or out}")


capture_app = typer.Typer(name="capture", no_args_is_help=True, add_completion=False)
import_app = typer.Typer(name="import", help="Make a capture from data in another format.", no_args_is_help=True)


@capture_app.callback()
def capture() -> None:
    """Check, import, refine and simulate captures, and add episodes."""


add_command(capture_app, CheckRequest, check, name="check", example="pinwm capture check mycapture")
add_command(capture_app, RefineRequest, refine, name="refine", example="pinwm capture refine mycapture refined")
capture_app.add_typer(import_app)
add_command(
    capture_app,
    SimulateCaptureRequest,
    simulate,
    name="simulate",
    example="pinwm capture simulate mycapture --object mug --friction 0.2",
)
add_command(
    capture_app,
    AddEpisodeRequest,
    add_episode,
    name="add-episode",
    example="pinwm capture add-episode mycapture --video push.mp4 --log robot.csv --columns t=stamp[ms],px=x[mm],...",
)
add_command(
    import_app,
    NerfstudioRequest,
    nerfstudio,
    name="nerfstudio",
    example="pinwm capture import nerfstudio scan mycapture --mesh mug.obj",
)
add_command(
    import_app,
    ColmapRequest,
    colmap,
    name="colmap",
    example="pinwm capture import colmap scan mycapture --mesh mug.obj --transform world.yaml",
)
add_command(
    import_app,
    PinwmRequest,
    pinwm,
    name="pinwm",
    example="pinwm capture import pinwm sim_push_t mycapture --mesh cube_t.obj --pusher-mesh ee.obj",
)
