"""`pinwm next-push`: options, and what the push is expected to tell."""

import math
from pathlib import Path
from typing import Annotated

import typer

from pinwm_drake.cli.console import say, stages_bar
from pinwm_drake.errors import require
from pinwm_drake.files import prepare_folder


def next_push(
    twin: Annotated[Path, typer.Argument(metavar="TWIN", help="Folder that `pinwm identify` wrote.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for push.yaml, trajectory.csv and next_push.png.")],
    low: Annotated[
        tuple[float, float], typer.Option(help="Lowest x and y of the pusher, in m.", show_default="anywhere")
    ] = (-math.inf, -math.inf),
    high: Annotated[
        tuple[float, float], typer.Option(help="Highest x and y of the pusher, in m.", show_default="anywhere")
    ] = (math.inf, math.inf),
    candidates: Annotated[int, typer.Option(help="How many random pushes are looked at.")] = 48,
    draws: Annotated[int, typer.Option(help="Draws of the twin that each is rolled out with.")] = 32,
    position: Annotated[float, typer.Option(help="Spread at rest that is good enough, in mm.")] = 2.0,
    yaw: Annotated[float, typer.Option(help="Spread at rest that is good enough, in degrees.")] = 2.0,
    seed: Annotated[int, typer.Option(help="Of the random pushes.")] = 0,
) -> None:
    """Proposes the push whose video would tell most about a twin, and says when none is needed any more.

    Film it, add it to the capture as an episode, and identify from all of them:
    pinwm identify CAPTURE TWIN --episode A --episode B.
    """
    from pinwm_drake.experiments.next_push import propose_push, write_proposal
    from pinwm_drake.twin.read import read_twin

    require("--position", position, position > 0, "above 0 mm")
    require("--yaw", yaw, yaw > 0, "above 0 degrees")
    require("--low, --high", (low, high), all(a < b for a, b in zip(low, high, strict=True)), "low below high")
    found = read_twin(twin)
    with stages_bar(transient=True) as progress:
        proposal = propose_push(
            found,
            low=low,
            high=high,
            number=candidates,
            draws=draws,
            tolerance=(1e-3 * position, math.radians(yaw)),
            seed=seed,
            report=lambda share: progress("pushing", share, ""),
        )
    prepare_folder(out)
    files = write_proposal(out, found, proposal)
    best, (mm, turn) = proposal.candidates[0], proposal.spread
    motion = best.motion
    angle = math.degrees(math.atan2(motion.direction_W[1], motion.direction_W[0]))
    start = ", ".join(f"{1e3 * x:.0f}" for x in motion.p_WP)
    say(f"nine of ten random pushes end within {1e3 * mm:.1f} mm and {math.degrees(turn):.1f}° (standard deviation)")
    if proposal.is_good_enough:
        say("that is good enough: a further push would hardly change what the twin predicts")
    say(
        f"the push that tells most starts at ({start}) mm towards {angle:.0f}°, {1e3 * motion.speed:.0f} mm/s for "
        f"{1e3 * motion.distance:.0f} mm: {best.information:.1f} nats, spread {1e3 * best.position:.1f} mm and "
        f"{math.degrees(best.yaw):.1f}°"
    )
    for path in files:
        say(f"wrote {path}")
