"""The `pinwm` application: its commands, and its exit codes.

Exit codes: 0 when all went well, 1 when an input was refused or a fault stopped a robot, 2 when the command line itself
makes no sense; 130, 143 and 129 when Ctrl-C, SIGTERM or a closed terminal ended `control`.
Only light modules are imported here, so that `pinwm --help` answers at once; each command imports its work.
"""

from typing import Annotated

import typer
from rich.console import Console
from rich.markup import escape

import pinwm_drake
from pinwm_drake.cli.align import align
from pinwm_drake.cli.arm import arm
from pinwm_drake.cli.capture import capture_app
from pinwm_drake.cli.command import add_command
from pinwm_drake.cli.control import control
from pinwm_drake.cli.cousins import cousins
from pinwm_drake.cli.crosscheck import crosscheck
from pinwm_drake.cli.demo import demo_app
from pinwm_drake.cli.evaluate import evaluate
from pinwm_drake.cli.export import export
from pinwm_drake.cli.identify import identify
from pinwm_drake.cli.model import model
from pinwm_drake.cli.next_push import next_push
from pinwm_drake.cli.predict import predict
from pinwm_drake.cli.rehearse import rehearse
from pinwm_drake.cli.report import report
from pinwm_drake.cli.reproduce import reproduce
from pinwm_drake.cli.simulate import simulate
from pinwm_drake.cli.train import train
from pinwm_drake.cli.view import view
from pinwm_drake.errors import PinwmError
from pinwm_drake.experiments.requests.control import ArmRequest, ControlRequest, ExportRequest
from pinwm_drake.experiments.requests.twins import (
    CousinsRequest,
    ModelRequest,
    NextPushRequest,
    PredictRequest,
    ReportRequest,
    ViewRequest,
)

app = typer.Typer(
    name="pinwm",
    help="Digital twins of pushed objects, and policies trained in them.",
    epilog="Example: pinwm demo; then open out/demo/index.html",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
    context_settings={"help_option_names": ["-h", "--help"]},
)
app.add_typer(demo_app)
app.command(epilog="Example: pinwm align capture out/align; then: pinwm view out/align")(align)
app.add_typer(capture_app, name="capture")
add_command(
    app,
    ArmRequest,
    arm,
    name="arm",
    example="pinwm arm; then, in another terminal: pinwm control out/bundle --engine lcm --arm",
)
add_command(
    app, ControlRequest, control, name="control", example="pinwm control out/bundle --simulate-arm --arm --meshcat"
)
add_command(
    app, CousinsRequest, cousins, name="cousins", example="pinwm cousins out/twin -o out/cousins --from-intervals"
)
app.command(epilog="Example: pinwm crosscheck out/twin --truth capture/ground_truth.yaml -o out/check")(crosscheck)
app.command(epilog="Example: pinwm evaluate out/policy --engine hydroelastic -o out/evaluation")(evaluate)
add_command(app, ExportRequest, export, name="export", example="pinwm export runs/push/best out/bundle --max-speed 0.1")
app.command(epilog="Example: pinwm identify capture out/twin; then: pinwm report out/twin")(identify)
add_command(app, ModelRequest, model, name="model", example="pinwm model out/twin out/model")
add_command(
    app,
    NextPushRequest,
    next_push,
    name="next-push",
    example="pinwm next-push out/twin -o out/next --low -0.3 -0.3 --high 0.3 0.3",
)
add_command(
    app,
    PredictRequest,
    predict,
    name="predict",
    example="pinwm predict out/twin capture/episodes/0001 -o out/poses.csv",
)
app.command(epilog="Example: pinwm rehearse push_t --faults --moments 5 -o out/rehearsal")(rehearse)
add_command(app, ReportRequest, report, name="report", example="pinwm report out/twin -o out/report.html")
app.command(epilog="Example: pinwm reproduce policies --task push --methods pin-wm,random --plan")(reproduce)
app.command(epilog="Example: pinwm simulate push_t --engine hydroelastic --video out/push.mp4")(simulate)
app.command(epilog="Example: pinwm train out/twin -o out/policy; then: pinwm evaluate out/policy")(train)
add_command(
    app, ViewRequest, view, name="view", example="pinwm view out/align --html out/object.html --video out/object.mp4"
)


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"pinwm {pinwm_drake.__version__}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    """The options that stand before a command; `version` has done its work by the time this runs."""


def main() -> None:
    """Runs `pinwm` on the command line and ends the process with its exit code."""
    try:
        app(prog_name="pinwm")
    except PinwmError as error:
        Console(stderr=True, soft_wrap=True).print(f"[bold red]pinwm:[/] {escape(str(error))}", highlight=False)
        raise SystemExit(1) from None
