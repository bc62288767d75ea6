# SPDX-License-Identifier: MIT
"""`pinwm simulate`: a bar of the time, and the push in a table."""

import logging
import math
import signal
from typing import TYPE_CHECKING

from rich.console import Console

from pinwm_drake.cli.console import LOOPBACK, say, stages_bar
from pinwm_drake.cli.stopping import stop_signals
from pinwm_drake.files import prepare_folder
from pinwm_drake.systems.runs.session_options import SimulateRequest

if TYPE_CHECKING:
    from rich.table import Table

    from pinwm_drake.systems.runs.episode import Record
    from pinwm_drake.systems.runs.session import Session


def simulate(request: SimulateRequest) -> None:
    """Push an object in a station: in its twin, or in Drake.

    Drake has two contact models, hydroelastic and point.
    """
    from pinwm_drake.geometry.primitive import acting_words
    from pinwm_drake.systems.runs.session import Session
    from pinwm_drake.systems.scenario.load import load_setup

    options, scenario, twin = request.options, request.scenario, request.twin
    logging.getLogger("drake").setLevel(logging.WARNING)  # Meshcat's address is said below
    for path in (options.record, options.video):
        if path is not None:
            prepare_folder(path.parent)
    scene = twin if scenario is None else scenario
    assert scene is not None  # as the request has checked
    setup = load_setup(scene, twin=None if scenario is None else twin)
    session = Session(setup, options)
    say(f"the object acts as {acting_words(setup.twin.acts_as)}")
    if options.meshcat:
        _announce(session, options.host)
    try:
        with stages_bar(transient=True) as progress:
            first = session.first(progress)
        Console().print(_summary(session, first))
        for path in (options.out, options.video, options.record):
            if path is not None:
                say(f"wrote {path}")
        if options.meshcat:
            with stop_signals() as stop:
                stop.defer()  # an exception would be lost, now and then, inside of Drake
                while not stop():
                    session.another(stop)
            say("ended")
            if stop.exit_code != 128 + signal.SIGINT:
                raise SystemExit(stop.exit_code)
    except KeyboardInterrupt:
        if not options.meshcat:
            raise
        say("ended")


def _announce(session: "Session", host: str) -> None:
    """Print the address of the page."""
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
    if station.world is not None:  # Drake's plants tell of none
        table.add_row("solver retries", str(session.retries))
    return table
