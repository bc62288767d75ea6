"""What `pinwm capture check` does: finds the problems of a capture and shows them."""

from collections import Counter
from pathlib import Path

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from pinwm_drake.capture.check import CheckResult, check_capture
from pinwm_drake.capture.checks.findings import Problem

_MOST = 8  # problems of one file that are shown
_STYLES = {"error": "bold red", "warning": "yellow"}


def run_check(folder: Path, *, every: bool) -> None:
    """Checks a capture and shows its problems.

    Args:
        folder: The capture.
        every: Whether all problems of a file are shown, however many there are.

    Raises:
        InputError: There is no such folder.
        SystemExit: With 1, where an error was found.
    """
    console = Console()
    with console.status("checking") as status:
        result = check_capture(folder, lambda part: status.update(f"checking {escape(part)}"))
    if result.problems:
        console.print(_table(folder, result, every))
    console.print(f"{folder}: {summary(result)}", style=_colour(result), highlight=False, markup=False, soft_wrap=True)
    if result.errors:
        raise SystemExit(1)


def summary(result: CheckResult) -> str:
    """What was found, in one line."""
    episodes, images = len(result.images), sum(result.images.values())
    parts = (
        _count(result.errors, "error"),
        _count(result.warnings, "warning"),
        _count(result.views, "static view"),
        f"{_count(episodes, 'episode')} of {_count(images, 'image')}",
    )
    return ", ".join(parts)


def _table(folder: Path, result: CheckResult, every: bool) -> Table:
    """The problems: errors before warnings, each with its place."""
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


def _row(folder: Path, problem: Problem) -> list[str]:
    error, style = problem.problem, _STYLES[problem.severity]
    where = _short(folder, error.path) + ("" if error.row is None else f", row {error.row}")
    found = "" if error.value is None else str(error.value)
    return [f"[{style}]{problem.severity}[/]", escape(where), escape(found), escape(error.allowed)]


def _short(folder: Path, path: str) -> str:
    """A path, from the capture's folder where it is in it."""
    try:
        return str(Path(path).relative_to(folder))
    except ValueError:
        return path


def _colour(result: CheckResult) -> str:
    return _STYLES["error"] if result.errors else _STYLES["warning"] if result.warnings else "bold green"


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}" + ("" if number == 1 else "s")
