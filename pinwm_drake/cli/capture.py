"""`pinwm capture`: its commands. The work of `check` is in `capture_check`; the others have modules of their own."""

from pathlib import Path
from typing import Annotated

import typer

from pinwm_drake.cli.capture_import import import_app
from pinwm_drake.cli.capture_simulate import simulate

capture_app = typer.Typer(name="capture", help="Check, import and simulate captures.", no_args_is_help=True)


@capture_app.command(epilog="Example: pinwm capture check mycapture")
def check(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="The capture: a folder with capture.yaml.")],
    every: Annotated[bool, typer.Option("--all", help="Show every problem, however many a file has.")] = False,
) -> None:
    """Lists everything that is wrong with a capture; exits with 1 where something makes it unusable."""
    from pinwm_drake.cli.capture_check import run_check

    run_check(folder, every=every)


capture_app.add_typer(import_app)
capture_app.command(epilog="Example: pinwm capture simulate mycapture --object mug --friction 0.2")(simulate)
