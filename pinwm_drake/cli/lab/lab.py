# SPDX-License-Identifier: MIT
"""`pinwm lab`: a new lab's folder, and the guide with one bar and the act that comes next."""

from typing import Any

import typer
from typer.core import TyperGroup

from pinwm_drake.cli.command import add_command
from pinwm_drake.cli.console import say, stages_bar, warn
from pinwm_drake.experiments.requests.lab import GuideRequest, NewLabRequest

_GUIDE = "guide"


class _Group(TyperGroup):
    """Group in which a folder in place of a command is that of the guide."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Put the guide's name before arguments that begin with none of the commands."""
        known = (*self.commands, *ctx.help_option_names)
        return super().parse_args(ctx, [_GUIDE, *args] if args and args[0] not in known else args)


lab_app = typer.Typer(name="lab", cls=_Group, no_args_is_help=True, add_completion=False)


@lab_app.callback()
def lab() -> None:
    """Guide a lab from a printed board to a policy.

    `pinwm lab LAB` is short for `pinwm lab guide LAB`. A folder called new or guide is written ./new or ./guide.
    """


def guide(request: GuideRequest) -> None:
    """Run what is ready in a lab, and say the next act.

    It writes lab.html with pictures of each stage. Call it again after each act; what is done stays.
    """
    from pinwm_drake.guide.guide import guide_lab
    from pinwm_drake.guide.page import PAGE_FILE
    from pinwm_drake.guide.stages import ACTS

    try:
        with stages_bar() as show:
            found = guide_lab(
                request.folder,
                train=request.train,
                run=request.run,
                progress=lambda stage, done, figures: show(stage, done, figures),
            )
    except KeyboardInterrupt:
        say("interrupted; the same command goes on")
        raise SystemExit(1) from None
    for status in found.seen:
        changed = f": {status.changed[0]} changed" if status.changed else ""
        say(f"{status.stage.title}: {status.state}{changed}")
        for note in status.notes:
            if note.startswith("doubtful"):
                say(f"  {note}", style="yellow")
    say(f"wrote {request.folder / PAGE_FILE}")
    if found.error:
        warn(f"{found.seen[-1].stage.title if found.seen else request.folder}: {found.error}")
        say(found.act)
        raise SystemExit(1)
    number = "" if found.number is None else f" (act {found.number} of {len(ACTS)})"
    say(f"next{number}: {found.act}", style="bold")


def new(request: NewLabRequest) -> None:
    """Make a lab's folder, a board to print, and a page of acts."""
    from pinwm_drake.guide.lab import BOARD_FILE
    from pinwm_drake.guide.new import FILMING_FILE, new_lab
    from pinwm_drake.guide.stages import ACTS

    made = new_lab(request.folder)
    say(f"wrote {made.path}: read {FILMING_FILE}, print {BOARD_FILE}; then: pinwm lab {made.path}")
    say(f"next (act 1 of {len(ACTS)}): {ACTS[0]}", style="bold")


add_command(lab_app, NewLabRequest, new, name="new", example="pinwm lab new mylab; then: pinwm lab mylab")
add_command(lab_app, GuideRequest, guide, name=_GUIDE, example="pinwm lab mylab; then open mylab/lab.html")
