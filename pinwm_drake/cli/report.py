"""`pinwm report`: its options. The work is in `report_run`."""

from pathlib import Path
from typing import Annotated

import typer


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
    from pinwm_drake.cli.report_run import run_report

    run_report(twin, out, capture)
