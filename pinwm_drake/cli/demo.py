# SPDX-License-Identifier: MIT
"""`pinwm demo`: its commands and their options. The work is in `pinwm_drake.demo`."""

from pathlib import Path
from typing import Annotated

import typer

from pinwm_drake.cli.command import add_command
from pinwm_drake.demo.push.options import PushRequest
from pinwm_drake.errors import ParameterError

_OUT = Path("out/demo")

demo_app = typer.Typer(name="demo", invoke_without_command=True, add_completion=False)


@demo_app.callback(epilog="Example: pinwm demo; then open out/demo/index.html")
def demo(
    context: typer.Context,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="Folder of the results.", show_default=str(_OUT))
    ] = None,
) -> None:
    """Make a twin from video, predict a push, and run a policy."""
    if context.invoked_subcommand is not None:
        if out is not None:
            raise ParameterError(
                f"--out: got {out} before {context.invoked_subcommand}; allowed: behind it, as its own option"
            )
        return
    from pinwm_drake.demo.main import run_demo

    run_demo(out or _OUT)


def push(request: PushRequest) -> None:
    """Push a T-block and differentiate the outcome."""
    from pinwm_drake.demo.push.report import run_push
    from pinwm_drake.files import prepare_folder

    run_push(prepare_folder(request.out), request.options)


add_command(
    demo_app, PushRequest, push, name="push", example="pinwm demo push --friction 0.1 --pusher capsule --out out/push"
)
