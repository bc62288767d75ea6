# SPDX-License-Identifier: MIT
"""`pinwm control`: lines of the state of a controlled station.

Exit codes: 0 when it ended by itself (at the goal, after its last action, at the end of its time, or a dry run), 1 when
an input was refused or a fault stopped the pusher, 130, 143 and 129 when Ctrl-C, SIGTERM or a closed terminal did.
"""

import logging
import math
import time
from contextlib import nullcontext
from typing import TYPE_CHECKING

from rich.console import Console
from rich.markup import escape

from pinwm_drake.cli.stopping import Stop, stop_signals
from pinwm_drake.errors import StateError
from pinwm_drake.experiments.requests.control import ControlRequest

if TYPE_CHECKING:
    from pydrake.geometry import Meshcat

    from pinwm_drake.learning.safety import SafetyLimits
    from pinwm_drake.systems.arm.model import ArmName
    from pinwm_drake.systems.control.loop import ControlLoop, ControlRow
    from pinwm_drake.systems.scenario.setup import Setup

UNSIGNED = "any process on this host can send commands to the robot, and images; --key FILE keeps others out"
_EVERY = 0.5  # s, between lines
_PATIENCE = 30.0  # s, for somebody to open the page


def control(request: ControlRequest) -> None:
    """Run a bundle on a simulation or a robot; --arm moves it.

    Without --arm nothing moves. Ctrl-C stops it, as do SIGTERM and a closed terminal: the robot is disarmed and sent
    zero, once.
    """
    with stop_signals() as stop:
        import numpy as np

        from pinwm_drake.files import prepare_folder
        from pinwm_drake.learning.bundle import read_bundle
        from pinwm_drake.station.named import require_station, station_hash
        from pinwm_drake.systems.control.loop import ControlLoop
        from pinwm_drake.systems.envs.options import EnvOptions, environment_setup
        from pinwm_drake.systems.envs.policy_scene import FORCE, policy_setup
        from pinwm_drake.systems.scenario.load import with_url
        from pinwm_drake.systems.scenario.schema import MEMORY
        from pinwm_drake.systems.sdf.twin import contact_name
        from pinwm_drake.systems.view.meshcat import make_meshcat, recorded

        console, engine, armed, film = Console(), request.station_engine, request.arm, request.record
        if film is not None:
            prepare_folder(film.parent)
        logging.getLogger("drake").setLevel(logging.WARNING)
        found = read_bundle(request.bundle)
        if request.station is not None or (engine == "lcm" and not request.simulate_arm):
            at = None if request.station is None else station_hash(request.station)
            require_station(request.bundle, found.spec.station, at, request.station)
        found = found if request.goal is None else found.toward(request.goal)
        force = None if request.force else FORCE
        setup = policy_setup(found.spec, found.provenance, request.bundle, request.scene, force)
        setup = environment_setup(setup, EnvOptions(image_size=found.spec.camera.width))
        if engine == "lcm":
            setup = with_url(setup, MEMORY if request.simulate_arm else request.lcm_url, request.key)
        page = make_meshcat(port=request.port) if request.meshcat or film is not None else None
        loop = ControlLoop(
            found,
            found.limits,
            setup,
            engine,
            armed=armed,
            simulate_arm=request.simulate_arm,
            arm=request.arm_model,
            contact=contact_name(request.contact),
            latency=request.latency,
            meshcat=page,
            recording=film is not None,
        )
        place = loop.draw_place(np.random.default_rng(request.seed))
        if page is not None and request.meshcat:
            loop.simulator.set_target_realtime_rate(1.0)
            _await_browser(console, page)
        recording = nullcontext() if film is None or page is None else recorded(page, film)
        with recording:
            loop.begin(place)
            arm = request.arm_model if request.simulate_arm else None
            _announce(console, armed, arm, engine, setup, found.limits)
            last = _run(console, loop, request.duration, stop)
        if film is not None:
            _tell(console, stop, f"wrote {escape(str(film))}")
        # What could go wrong now is no danger to a robot.
        _conclude(console, last, armed, request.duration, stop)
        if request.meshcat and console.is_terminal and not stop():
            _keep(console, stop)


def _run(console: Console, loop: "ControlLoop", duration: float, stop: Stop) -> "ControlRow":
    """Run a loop for a duration [s] with a line now and then, disarm it whatever happens, and give its last row."""
    due, state = 0.0, ""
    try:
        loop.listen(stop=stop, arming=stop.defer)
        stop.defer()
        began, start, row = time.perf_counter(), loop.simulator.get_context().get_time(), loop.row()
        for row in loop.advance(duration, stop=stop):
            t = row.t - start
            if t >= due - 1e-6 or row.status.state != state:
                _tell(console, stop, _line(t, row, time.perf_counter() - began))
                due, state = t + _EVERY, row.status.state
            _tell_unused(console, loop, stop, time.monotonic())
    finally:
        loop.stop()
        _tell_unused(console, loop, stop, math.inf)
    return row


def _tell_unused(console: Console, loop: "ControlLoop", stop: Stop, now: float) -> None:
    """Print the counts of messages that were not used, where that is due at a time [s]."""
    from pinwm_drake.systems.engines.lcm.engine import LcmHandle

    handle = loop.station.engine.handle
    tallies = [handle.tally] if isinstance(handle, LcmHandle) else []
    for tally in tallies if loop.driver is None else [*tallies, loop.driver.tally]:
        if line := tally.line(now):
            _tell(console, stop, f"[yellow]{escape(line)}[/]")


def _tell(console: Console, stop: Stop, line: str) -> None:
    """Print a line; where the terminal takes none any more, that is a wish to stop."""
    try:
        console.print(line, highlight=False, soft_wrap=True)
    except OSError:
        stop.close()


def _announce(
    console: Console, armed: bool, arm: "ArmName | None", engine: str, setup: "Setup", limits: "SafetyLimits"
) -> None:
    """Print the name of the controlled robot or engine, whether the pusher moves, its limits, and what it lacks."""
    from pinwm_drake.systems.arm.driver import arm_limits

    what = {True: "[bold]armed[/]: the pusher moves", False: "[bold]dry run[/]: nothing moves (--arm does)"}
    where = "a simulated arm" if arm else engine
    if engine == "lcm" and not arm:
        where = f"a robot at {escape(setup.scenario.lcm.url)}"
    console.print(f"{where}, {what[armed]}", highlight=False, soft_wrap=True)
    console.print(
        f"limits: {limits.max_speed:g} m/s, {limits.max_acceleration:g} m/s², images {limits.max_image_age:g} s old, "
        f"{_corner(limits.box_low)} to {_corner(limits.box_high)} m",
        highlight=False,
        soft_wrap=True,
    )
    if engine == "lcm" and not arm:
        key = setup.scenario.lcm.key_file
        if key is None:
            console.print(f"[yellow]{UNSIGNED}[/]", highlight=False, soft_wrap=True)
        else:
            console.print(f"messages are signed with the key in {escape(key)}", highlight=False, soft_wrap=True)
    short = limits.shortfall(arm_limits(setup, arm)) if arm else ""
    if short:
        console.print(f"[yellow]the arm is slower than the policy was trained for[/]: {short}", highlight=False)


def _await_browser(console: Console, meshcat: "Meshcat") -> None:
    """Print the address of the page; on a terminal, count down until somebody opens it or the time is over."""
    console.print(f"Meshcat is at {meshcat.web_url()}", highlight=False, soft_wrap=True)
    if not console.is_terminal:
        return
    end = time.monotonic() + _PATIENCE
    with console.status("") as waiting:
        while not (seen := meshcat.GetNumActiveConnections()) and (left := end - time.monotonic()) > 0:
            waiting.update(f"waiting for a browser: the run begins in {math.ceil(left)} s at the latest")
            time.sleep(0.1)
    if not seen:
        console.print(f"no browser opened the page within {_PATIENCE:g} s: the run begins", highlight=False)


def _keep(console: Console, stop: Stop) -> None:
    """Keep the page until Ctrl-C."""
    _tell(console, stop, "Ctrl-C ends")
    while not stop():
        time.sleep(0.1)


def _corner(p: tuple[float, float, float]) -> str:
    return f"({', '.join(f'{x:g}' for x in p)})"


def _line(t: float, row: "ControlRow", wall: float) -> str:
    """Line of the controller's status: time, state, action, pusher, object, and pace."""
    status, action, p = row.status, 1e3 * row.raw_action, 1e3 * row.p_WP
    parts, components = [f"{t:6.2f} s  {status.state}"], ", ".join(f"{value:+.1f}" for value in action)
    parts.append("" if math.isnan(action[0]) else f"action ({components}) mm{' cut' if status.limited else ''}")
    parts.append(f"pusher ({p[0]:+.1f}, {p[1]:+.1f}) mm")
    if not math.isnan(row.distance):
        parts.append(f"object {1e3 * row.distance:.1f} mm, {math.degrees(row.angle):.1f}° from the goal")
    if status.estimate:
        parts.append(f"seen {escape(status.estimate)}")
    if t > 0:
        parts.append(f"{t / max(wall, 1e-9):.2f} x real time")
    return "  ".join(part for part in [*parts, escape(status.reason)] if part)


def _conclude(console: Console, row: "ControlRow", armed: bool, duration: float, stop: Stop) -> None:
    """Print how a run ended; raise StateError where a fault stopped the pusher, SystemExit where a signal did."""
    if row.status.state == "latched":
        raise StateError(f"the pusher was stopped: {row.status.reason}")
    end = "disarmed, and zero was sent" if armed else "dry run: nothing was moved"
    if stop():
        _tell(console, stop, f"stopped by {stop()}: {end}")
        raise SystemExit(stop.exit_code)
    if not armed:
        _tell(console, stop, end)
    elif row.success:
        _tell(console, stop, f"[green]at the goal[/] after {row.status.actions} actions: {end}")
    elif row.status.state == "done":
        _tell(console, stop, f"[green]done[/]: {escape(row.status.reason)}: {end}")
    else:
        _tell(console, stop, f"[yellow]not at the goal[/] after {duration:g} s: {end}")
