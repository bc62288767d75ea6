# SPDX-License-Identifier: MIT
"""`pinwm capture`: `check`, `refine`, and the commands that have modules of their own."""

from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING

import typer
from rich.console import Console
from rich.markup import escape

from pinwm_drake.cli.capture_import import import_app
from pinwm_drake.cli.command import add_command
from pinwm_drake.cli.console import say, stages_bar
from pinwm_drake.experiments.requests.captures import CheckRequest, RefineRequest
from pinwm_drake.systems.runs.capture_options import SimulateCaptureRequest

if TYPE_CHECKING:
    from rich.table import Table

    from pinwm_drake.capture.check import CheckResult
    from pinwm_drake.capture.checks.findings import Problem

_MOST = 8  # problems of one file that are shown
_STYLES = {"error": "bold red", "warning": "yellow"}


def check(request: CheckRequest) -> None:
    """List everything that is wrong with a capture; exits with 1 where something makes it unusable."""
    from pinwm_drake.capture.check import check_capture

    console, folder = Console(), request.folder
    with console.status("checking") as status:
        result = check_capture(folder, lambda part: status.update(f"checking {escape(part)}"))
    if result.problems:
        console.print(_table(folder, result, request.every))
    console.print(f"{folder}: {_summary(result)}", style=_colour(result), highlight=False, markup=False, soft_wrap=True)
    if result.errors:
        raise SystemExit(1)


def refine(request: RefineRequest) -> None:
    """Copy a capture and fit its mesh to the masks of the static views, where it is a few millimetres wrong."""
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
    """Make a capture from Drake: a stand-in for a robot that pushes an object in front of a camera."""
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
        f"{_count(episodes, 'episode')} of {_count(images, 'image')}",
    )
    return ", ".join(parts)


def _table(folder: Path, result: "CheckResult", every: bool) -> "Table":
    """Table of the problems: errors before warnings, each with its place."""
    from rich.table import Table

    table = Table("", title="Problems", show_lines=True)
    for name in ("where", "found", "allowed"):
        table.add_column(name, overflow="fold")
    shown: Counter[str] = Counter()
    left_out: Counter[str] = Counter()
    for problem in sorted(result.problems, key=lambda problem: problem.severity):
        path = problem.problem.path
        shown[path] += 1
        if shown[path] > _MOST and not every:
            left_out[path] += 1
            continue
        table.add_row(*_row(folder, problem))
    for path, count in left_out.items():
        table.add_row("", escape(_short(folder, path)), f"{count} more; --all shows them", "")
    return table


def _row(folder: Path, problem: "Problem") -> list[str]:
    error, style = problem.problem, _STYLES[problem.severity]
    where = _short(folder, error.path) + ("" if error.row is None else f", row {error.row}")
    found = "" if error.value is None else str(error.value)
    return [f"[{style}]{problem.severity}[/]", escape(where), escape(found), escape(error.allowed)]


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


capture_app = typer.Typer(name="capture", no_args_is_help=True, add_completion=False)


@capture_app.callback()
def capture() -> None:
    """Check, import, refine and simulate captures."""


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
