"""What `pinwm report` does."""

from pathlib import Path

from rich.console import Console
from rich.progress import Progress

from pinwm_drake.errors import InputError, ParameterError
from pinwm_drake.files import prepare_folder
from pinwm_drake.report.twin.data import read_story
from pinwm_drake.report.twin.report import write_twin_report

REPORT_FILE = "report.html"
_SUFFIXES = (".html", ".htm")


def run_report(twin: Path, out: Path | None, capture: Path | None) -> None:
    """Writes the report of a twin.

    Args:
        twin: The twin's folder.
        out: The file; None for `report.html` in that folder.
        capture: Where the capture is now; None for where the twin says it was.

    Raises:
        PinwmError: The twin or the capture that was named cannot be read, or the file cannot be written.
    """
    path = twin / REPORT_FILE if out is None else out
    if path.suffix.lower() not in _SUFFIXES:
        raise ParameterError(f"--out: got {path}; allowed: a name that ends in {' or '.join(_SUFFIXES)}")
    if path.is_dir():
        raise InputError(path, value="a folder", allowed="a file")
    story = read_story(twin, capture)
    prepare_folder(path.parent)
    console = Console()
    with Progress(console=console, transient=True, disable=not console.is_terminal) as progress:
        task = progress.add_task("drawing", total=1.0)
        verdict = write_twin_report(path, story, lambda share: progress.update(task, completed=share))
    for line in (f"{verdict.headline}.", *verdict.lines):
        console.print(line, highlight=False, soft_wrap=True, markup=False)
    errors = Console(stderr=True, soft_wrap=True)
    for notice in story.notices:
        errors.print(f"note: {notice}", highlight=False, markup=False)
    console.print(f"wrote {path}", highlight=False, soft_wrap=True, markup=False)
