"""`pinwm demo`: its commands and their options. The work is in `pinwm_drake.demo`."""

from pathlib import Path
from typing import Annotated

import typer

from pinwm_drake.errors import ParameterError

_OUT = Path("out/demo")

demo_app = typer.Typer(name="demo", invoke_without_command=True)


@demo_app.callback(epilog="Example: pinwm demo; then open out/demo/index.html")
def demo(
    context: typer.Context,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="Folder of the results.", show_default=str(_OUT))
    ] = None,
) -> None:
    """Makes a twin from the video of a push, predicts another push, and lets the shipped policy act in it."""
    if context.invoked_subcommand is not None:
        if out is not None:
            raise ParameterError(
                f"--out: got {out} before {context.invoked_subcommand}; allowed: behind it, as its own option"
            )
        return
    from pinwm_drake.demo.main import run_demo

    run_demo(out or _OUT)


@demo_app.command(epilog="Example: pinwm demo push --friction 0.1 --pusher capsule --out out/push")
def push(
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for trajectory.csv, push.png and push.mp4.")] = Path(
        "out/push"
    ),
    friction: Annotated[float, typer.Option(help="Friction coefficient of block and floor.")] = 0.03,
    pusher_friction: Annotated[float, typer.Option(help="Friction coefficient of block and pusher.")] = 0.1,
    speed: Annotated[float, typer.Option(help="Speed of the pusher, in m/s.")] = 0.15,
    offset: Annotated[float, typer.Option(help="Where it hits, sideways of the centre of mass, in m.")] = 0.01,
    seconds: Annotated[float, typer.Option(help="Simulated time, in s; the pusher moves for 2/3 of it.")] = 2.4,
    time_step: Annotated[float, typer.Option(help="Time step, in s.", show_default="1/240")] = 1 / 240,
    pusher: Annotated[str, typer.Option(help="Shape of the pusher: sphere, capsule or cylinder.")] = "sphere",
) -> None:
    """Pushes a T-block across the floor and differentiates the outcome through every contact."""
    from pinwm_drake.demo.push.options import PushOptions
    from pinwm_drake.demo.push.report import run_push
    from pinwm_drake.files import prepare_folder

    options = PushOptions(
        friction=friction,
        pusher_friction=pusher_friction,
        speed=speed,
        offset=offset,
        seconds=seconds,
        time_step=time_step,
        pusher=pusher,
    )
    run_push(prepare_folder(out), options)
