"""`pinwm simulate`: options, a bar of the time, and the push in a table."""

import logging
import math
import signal
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console

from pinwm_drake.cli.console import LOOPBACK, say, stages_bar
from pinwm_drake.cli.stopping import stop_signals
from pinwm_drake.errors import InputError, ParameterError
from pinwm_drake.files import prepare_folder

if TYPE_CHECKING:
    from rich.table import Table

    from pinwm_drake.systems.runs.episode import Record
    from pinwm_drake.systems.runs.session import Session


def simulate(
    scenario: Annotated[
        str | None,
        typer.Argument(
            metavar="SCENARIO",
            help="A .scenario.yaml file, the name of one that ships, such as push_t, or the folder of a twin.",
            show_default=False,
        ),
    ] = None,
    engine: Annotated[
        str | None, typer.Option(help="twin, hydroelastic or point.", show_default="that of the scenario")
    ] = None,
    twin: Annotated[
        Path | None, typer.Option(help="Folder of a twin, in place of the scenario's object.", show_default="none")
    ] = None,
    seed: Annotated[
        int | None, typer.Option(help="Of the start and of the push.", show_default="that of the scenario")
    ] = None,
    duration: Annotated[
        float | None, typer.Option(help="Simulated time, in s.", show_default="until the object rests")
    ] = None,
    push: Annotated[
        str, typer.Option(help="straight, for one through the object, or a trajectory.csv to be replayed.")
    ] = "straight",
    meshcat: Annotated[
        bool, typer.Option("--meshcat", help="Show it in the browser, in real time, push after push until Ctrl-C.")
    ] = False,
    host: Annotated[
        str, typer.Option(help="Address for --meshcat to listen on; others than this let other machines in.")
    ] = "localhost",
    port: Annotated[int | None, typer.Option(help="Port to listen on.", show_default="first free from 7000")] = None,
    record: Annotated[
        Path | None, typer.Option(help="Write what Meshcat shows as one .html file that needs no server.")
    ] = None,
    video: Annotated[
        Path | None, typer.Option(help="Film the scene, and beside it the port `rgb`, to this .mp4 file.")
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out", "-o", help="Folder, new or empty, for an episode as captures have it: poses, pusher's log, images."
        ),
    ] = None,
) -> None:
    """Pushes an object in a station, whatever moves it: the learned twin, or Drake's contact models."""
    from pinwm_drake.models import shipped_scenarios
    from pinwm_drake.systems.runs.session import Session, SessionOptions
    from pinwm_drake.systems.scenario.load import load_setup

    options = SessionOptions(
        engine=engine,
        seed=seed,
        duration=duration,
        push=push,
        meshcat=meshcat,
        host=host,
        port=port,
        record=record,
        video=video,
        out=out,
    )
    logging.getLogger("drake").setLevel(logging.WARNING)  # Meshcat's address is said below
    for path in (record, video):
        if path is not None:
            _require_free(path)
    scene = twin if scenario is None else scenario
    if scene is None:
        raise ParameterError(f"SCENARIO: got none, and no --twin; allowed: a file, {', '.join(shipped_scenarios())}")
    session = Session(load_setup(scene, twin=None if scenario is None else twin), options)
    if meshcat:
        _announce(session, host)
    try:
        with stages_bar(transient=True) as progress:
            first = session.first(progress)
        Console().print(_summary(session, first))
        for path in (out, video, record):
            if path is not None:
                say(f"wrote {path}")
        if meshcat:
            with stop_signals() as stop:
                stop.defer()  # an exception would be lost, now and then, inside of Drake
                while not stop():
                    session.another(stop)
            say("ended")
            if stop.exit_code != 128 + signal.SIGINT:
                raise typer.Exit(stop.exit_code)
    except KeyboardInterrupt:
        if not meshcat:
            raise
        say("ended")


def _require_free(path: Path) -> None:
    """Makes the folder of a file; raises InputError where a folder has its name."""
    if path.is_dir():
        raise InputError(path, value="a folder", allowed="a file")
    prepare_folder(path.parent)


def _announce(session: "Session", host: str) -> None:
    """Prints the address of the page."""
    assert session.meshcat is not None
    say(f"Meshcat is at {session.meshcat.web_url()}")
    if not host.startswith(LOOPBACK):
        Console().print(f"[yellow]Other machines can open it too, as it listens on {host}.[/]")
    say("Ctrl-C ends.")


def _summary(session: "Session", record: "Record") -> "Table":
    """Table of the object's motion, and of the time that it took."""
    from rich.table import Table

    station = session.station
    table = Table(show_header=False, title=station.setup.scenario.name)
    x, y, z = 1e3 * record.displacement
    table.add_row("engine", station.engine.name)
    table.add_row("object moved", f"{math.hypot(x, y, z):.1f} mm ({x:+.1f}, {y:+.1f}, {z:+.1f})")
    table.add_row("object turned", f"{math.degrees(record.rotation):.1f}°")
    table.add_row("at rest", "yes" if record.at_rest else "no")
    table.add_row("simulated", f"{record.t[-1]:.3f} s, {record.t[-1] / record.wall_time:.2f} x real time")
    table.add_row("solver retries", "not known" if station.world is None else str(session.retries))
    return table
