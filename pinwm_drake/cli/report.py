"""`pinwm report`: options, and the verdict in a few lines."""

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from pinwm_drake.cli.console import say, stages_bar
from pinwm_drake.errors import InputError, require
from pinwm_drake.files import prepare_folder

REPORT_FILE = "report.html"
_SUFFIXES = (".html", ".htm")


def report(
    twin: Annotated[Path, typer.Argument(metavar="TWIN", help="Folder that `pinwm identify` wrote.")],
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="File of the page.", show_default="TWIN/report.html")
    ] = None,
    capture: Annotated[
        Path | None,
        typer.Option(help="Where the capture is now.", show_default="where it was when the twin was identified"),
    ] = None,
) -> None:
    """Writes one web page that needs no network: parameters, pictures, film, motion, course and provenance."""
    from pinwm_drake.report.twin.data import read_story
    from pinwm_drake.report.twin.report import write_twin_report

    path = twin / REPORT_FILE if out is None else out
    require("--out", path, path.suffix.lower() in _SUFFIXES, f"a name that ends in {' or '.join(_SUFFIXES)}")
    if path.is_dir():
        raise InputError(path, value="a folder", allowed="a file")
    story = read_story(twin, capture)
    prepare_folder(path.parent)
    with stages_bar(transient=True) as show:
        verdict = write_twin_report(path, story, lambda share: show("drawing", share, ""))
    for line in (f"{verdict.headline}.", *verdict.lines):
        say(line)
    errors = Console(stderr=True, soft_wrap=True)
    for notice in story.notices:
        errors.print(f"note: {notice}", highlight=False, markup=False)
    say(f"wrote {path}")
