# SPDX-License-Identifier: MIT
"""The `pinwm` application: its commands, and its exit codes.

Exit codes: 0 when all went well, 1 when an input was refused or a fault stopped a robot, 2 when the command line itself
makes no sense; 130, 143 and 129 when Ctrl-C, SIGTERM or a closed terminal ended `control`.
Only light modules are imported here, so that `pinwm --help` answers at once; each command imports its work.
"""

from collections.abc import Callable
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
from pinwm_drake.experiments.requests.control import ArmRequest, ControlRequest, ExportRequest, RehearseRun
from pinwm_drake.experiments.requests.evaluate import EvaluateRun
from pinwm_drake.experiments.requests.identify import AlignRequest, IdentifyRequest
from pinwm_drake.experiments.requests.train import TrainRequest
from pinwm_drake.experiments.requests.twins import (
    CousinsRequest,
    ModelRequest,
    NextPushRequest,
    PredictRequest,
    ReportRequest,
    ViewRequest,
)
from pinwm_drake.paper.reproduce.request import ReproduceRun
from pinwm_drake.systems.crosscheck.options import CrossCheckRequest
from pinwm_drake.systems.runs.session_options import SimulateRequest

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
app.add_typer(capture_app)
_COMMANDS: tuple[tuple[type, Callable[..., None], str], ...] = (
    (AlignRequest, align, "pinwm align capture out/align; then: pinwm view out/align"),
    (ArmRequest, arm, "pinwm arm; then, in another terminal: pinwm control out/bundle --engine lcm --arm"),
    (ControlRequest, control, "pinwm control out/bundle --simulate-arm --arm --meshcat"),
    (CousinsRequest, cousins, "pinwm cousins out/twin -o out/cousins --from-intervals"),
    (CrossCheckRequest, crosscheck, "pinwm crosscheck out/twin --truth capture/ground_truth.yaml -o out/check"),
    (EvaluateRun, evaluate, "pinwm evaluate out/policy --engine hydroelastic -o out/evaluation"),
    (ExportRequest, export, "pinwm export runs/push/best out/bundle --max-speed 0.1"),
    (IdentifyRequest, identify, "pinwm identify capture out/twin; then: pinwm report out/twin"),
    (ModelRequest, model, "pinwm model out/twin out/model"),
    (NextPushRequest, next_push, "pinwm next-push out/twin -o out/next --low -0.3 -0.3 --high 0.3 0.3"),
    (PredictRequest, predict, "pinwm predict out/twin capture/episodes/0001 -o out/poses.csv"),
    (RehearseRun, rehearse, "pinwm rehearse push_t --faults --moments 5 -o out/rehearsal"),
    (ReportRequest, report, "pinwm report out/twin -o out/report.html"),
    (ReproduceRun, reproduce, "pinwm reproduce policies --task push --methods pin-wm,random --plan"),
    (SimulateRequest, simulate, "pinwm simulate push_t --engine hydroelastic --video out/push.mp4"),
    (TrainRequest, train, "pinwm train out/twin -o out/policy; then: pinwm evaluate out/policy"),
    (ViewRequest, view, "pinwm view out/align --html out/object.html --video out/object.mp4"),
)
for _request, _run, _example in _COMMANDS:
    add_command(app, _request, _run, name=_run.__name__.replace("_", "-"), example=_example)


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
