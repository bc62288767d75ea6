# SPDX-License-Identifier: MIT
"""The `pinwm` application: its commands, and its exit codes.

Exit codes: 0 when all went well, 1 when an input was refused or a fault stopped a robot, 2 when the command line itself
makes no sense; 130, 143 and 129 when Ctrl-C, SIGTERM or a closed terminal ended `control`.
The module of a command is imported when the command is called or completed, so that `pinwm --help` answers at once.
"""

import ast
import errno
import importlib
import os
import pkgutil
import resource
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Annotated, Any, get_type_hints

import typer
from rich.console import Console
from rich.markup import escape
from typer.core import TyperCommand

import pinwm_drake
from pinwm_drake.cli.console import quiet, take_any_terminal
from pinwm_drake.errors import InputError, PinwmError
from pinwm_drake.nearest import nearest

app = typer.Typer(
    name="pinwm",
    help="Digital twins of pushed objects, and policies trained in them.",
    epilog="Example: pinwm demo; then open out/demo/index.html",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
    context_settings={"help_option_names": ["-h", "--help"]},
)
_EXAMPLES = {  # those of groups stand with their commands
    "demo": "",
    "capture": "",
    "align": "pinwm align capture out/align; then: pinwm view out/align",
    "arm": "pinwm arm; then, in another terminal: pinwm control out/bundle --engine lcm --arm",
    "calibrate": "pinwm calibrate --board board.pdf; then: pinwm calibrate mylab",
    "control": "pinwm control out/bundle --simulate-arm --arm --meshcat",
    "cousins": "pinwm cousins out/twin -o out/cousins --from-intervals",
    "crosscheck": "pinwm crosscheck out/twin --truth capture/ground_truth.yaml -o out/check",
    "doctor": "pinwm doctor; for a report of a fault: pinwm doctor --json",
    "evaluate": "pinwm evaluate out/policy --engine hydroelastic -o out/evaluation",
    "export": "pinwm export runs/push/best out/bundle --max-speed 0.1",
    "identify": "pinwm identify capture out/twin; then: pinwm report out/twin",
    "lab": "",
    "mask": "pinwm mask mycapture; then: pinwm capture check mycapture",
    "mesh": "pinwm mesh mycapture --from scan.stl; then: pinwm pose mycapture",
    "model": "pinwm model out/twin out/model",
    "next-push": "pinwm next-push out/twin -o out/next --low -0.3 -0.3 --high 0.3 0.3",
    "pose": "pinwm pose mycapture; then: pinwm align mycapture out/align",
    "predict": "pinwm predict out/twin capture/episodes/0001 -o out/poses.csv",
    "rehearse": "pinwm rehearse push_t --faults --moments 5 -o out/rehearsal",
    "report": "pinwm report out/twin -o out/report.html",
    "reproduce": "pinwm reproduce policies --task push --methods pin-wm,random --plan",
    "simulate": "pinwm simulate push_t --engine hydroelastic --video out/push.mp4",
    "train": "pinwm train out/twin -o out/policy; then: pinwm evaluate out/policy",
    "view": "pinwm view out/align --html out/object.html --video out/object.mp4",
}
_PACKAGE = "pinwm_drake.cli"
_LAB = {"calibrate", "lab", "mask", "mesh", "pose"}  # in a folder of their own


class _LazyCommand(TyperCommand):
    """Command in a list; the context that it makes is that of the command that its callback loads."""

    def make_context(self, *args: Any, **keywords: Any) -> Any:
        assert self.callback is not None
        return self.callback().make_context(*args, **keywords)


def _add_command(name: str, example: str) -> None:
    """Add a command, or a group of commands, of the module `pinwm_drake.cli.NAME` or `pinwm_drake.cli.lab.NAME`.

    The module defines a function of this name, whose docstring is the help. A command's function takes a request; a
    group's module defines `NAME_app` as well.
    """
    function = name.replace("-", "_")
    package = f"{_PACKAGE}.lab" if name in _LAB else _PACKAGE

    def load() -> Any:
        from pinwm_drake.cli.command import add_command

        module = importlib.import_module(f"{package}.{function}")
        group = getattr(module, f"{function}_app", None)
        if group is None:
            run = getattr(module, function)
            request = next(iter(get_type_hints(run).values()))
            group = typer.Typer(add_completion=False)
            add_command(group, request, run, name=name, example=example)
        return typer.main.get_command(group)

    app.command(name, cls=_LazyCommand, help=_docstring(package, function))(load)


def _docstring(package: str, function: str) -> str:
    """Docstring of a command's function, read from the source of its module."""
    source = pkgutil.get_data(package, f"{function}.py")
    assert source is not None
    for node in ast.parse(source).body:
        if isinstance(node, ast.FunctionDef) and node.name == function:
            return ast.get_docstring(node) or ""
    raise LookupError(f"{package}.{function} has no function {function}")


for _name, _example in _EXAMPLES.items():
    _add_command(_name, _example)


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
    """Return the options that stand before a command; `version` has done its work by the time this runs."""


@contextmanager
def _told() -> Iterator[None]:
    """Context in which any library's error for want of memory, or for a name that no file can have, is a PinwmError."""
    try:
        yield
    except (MemoryError, RuntimeError, OSError, ImportError) as error:
        if isinstance(error, OSError) and error.errno == errno.ENAMETOOLONG and error.filename:
            raise InputError(error.filename, value=error.strerror, allowed="a shorter name") from error
        words = str(error)
        limited = resource.getrlimit(resource.RLIMIT_AS)[0] != resource.RLIM_INFINITY
        short = isinstance(error, MemoryError) or "allocate memory" in words or (limited and "shared object" in words)
        if not short or isinstance(error, PinwmError):
            raise
        advice = "a machine or container with more memory, or a higher limit (ulimit -v)"
        raise PinwmError(f"memory: got too little ({words[:100]}); allowed: {advice}") from error


def _require_working_folder() -> None:
    """Raise InputError where the working folder was removed: libraries then end the process in words of their own."""
    try:
        os.getcwd()
    except OSError as error:
        raise InputError(
            "working folder", value="no such folder", allowed="a folder that is there; cd to one"
        ) from error


def main() -> None:
    """Run `pinwm` on the command line and end the process with its exit code."""
    take_any_terminal()
    try:
        _require_working_folder()
        with quiet(), _told():
            app(prog_name="pinwm")
    except PinwmError as error:
        text, near = str(error), nearest(error)
        text += f" (did you mean {near}?)" if near and "did you mean" not in text else ""
        Console(stderr=True, soft_wrap=True).print(f"[bold red]pinwm:[/] {escape(text)}", highlight=False)
        raise SystemExit(1) from None
