"""What `pinwm control` does."""

import logging
import math
import time
from dataclasses import dataclass

import numpy as np
from pydrake.geometry import Meshcat
from rich.console import Console

from pinwm_drake.errors import ParameterError, StateError
from pinwm_drake.learning.bundle import read_bundle
from pinwm_drake.learning.safety import SafetyLimits
from pinwm_drake.models import policy_path
from pinwm_drake.systems.control.loop import ControlLoop, ControlRow
from pinwm_drake.systems.envs.options import EnvOptions, environment_setup
from pinwm_drake.systems.scenario.load import load_setup, with_url
from pinwm_drake.systems.scenario.schema import MEMORY
from pinwm_drake.systems.scenario.setup import Setup
from pinwm_drake.systems.sdf.twin import contact_name
from pinwm_drake.systems.station.station import STATION_ENGINES
from pinwm_drake.systems.view.scene import make_meshcat

_EVERY = 0.5  # s, between lines
_PATIENCE = 30.0  # s, for somebody to open the page


@dataclass(frozen=True)
class ControlOptions:
    """The options of `pinwm control`, named and in units as there.

    Raises:
        ParameterError: One is out of range, or does not go with another.
    """

    scene: str
    engine: str
    arm: bool
    simulate_arm: bool
    contact: str
    duration: float
    seed: int
    lcm_url: str | None
    meshcat: bool
    port: int | None

    def __post_init__(self) -> None:
        """Checks every option."""
        require("--engine", self.engine, self.engine in STATION_ENGINES, ", ".join(STATION_ENGINES))
        require("--duration", self.duration, 0.1 <= self.duration <= 600, "0.1 to 600 s")
        require_common(self.contact, self.seed)
        robot = self.engine == "lcm" and not self.simulate_arm
        require("--lcm-url", self.lcm_url, self.lcm_url is None or robot, "none, but for a robot behind lcm")
        require("--meshcat", self.meshcat, not (self.meshcat and robot), "none for a robot, which can be looked at")


def run_control(policy: str, options: ControlOptions) -> None:
    """Runs a bundle's policy on a station.

    Args:
        policy: Folder of the bundle, or the name of one that ships.
        options: The options.

    Raises:
        PinwmError: An input was refused, nothing came from the robot, or a fault stopped the pusher.
    """
    console = Console()
    logging.getLogger("drake").setLevel(logging.WARNING)
    bundle = read_bundle(policy_path(policy))
    setup = environment_setup(load_setup(options.scene), EnvOptions(image_size=bundle.spec.camera.width))
    if options.engine == "lcm":
        setup = with_url(setup, MEMORY if options.simulate_arm else options.lcm_url)
    meshcat = make_meshcat(port=options.port) if options.meshcat else None
    loop = ControlLoop(
        bundle,
        bundle.limits,
        setup,
        options.engine,
        armed=options.arm,
        simulate_arm=options.simulate_arm,
        contact=contact_name(options.contact),
        meshcat=meshcat,
    )
    place = loop.draw_place(np.random.default_rng(options.seed))
    if meshcat is not None:
        loop.simulator.set_target_realtime_rate(1.0)
        _await_browser(console, meshcat)
    loop.begin(place)
    _announce(console, options, setup, bundle.limits)
    loop.listen()
    last = _run(console, loop, options.duration)
    _conclude(console, last, options)
    if meshcat is not None and console.is_terminal:
        _keep(console)


def require_common(contact: str, seed: int) -> None:
    """Checks what `pinwm control` and `pinwm arm` both have."""
    require("--contact", contact, contact in ("hydroelastic", "point"), "hydroelastic, point")
    require("--seed", seed, 0 <= seed < 2**32, "0 to 4294967295")


def require(name: str, value: object, allowed: bool, range_in_words: str) -> None:
    """Raises ParameterError unless an option is allowed."""
    if not allowed:
        raise ParameterError(f"{name}: got {value}; allowed: {range_in_words}")


def _run(console: Console, loop: ControlLoop, duration: float) -> ControlRow:
    """Goes on to the end, with a line now and then; disarms whatever happens."""
    began, due, state = time.perf_counter(), 0.0, ""
    start = loop.simulator.get_context().get_time()
    try:
        for row in loop.advance(duration):
            t = row.t - start
            if t >= due - 1e-6 or row.status.state != state:
                console.print(_line(t, row, time.perf_counter() - began), highlight=False, soft_wrap=True)
                due, state = t + _EVERY, row.status.state
    except KeyboardInterrupt:
        console.print("stopped", highlight=False)
        row = loop.row()
    finally:
        loop.stop()
    return row


def _announce(console: Console, options: ControlOptions, setup: Setup, limits: SafetyLimits) -> None:
    what = {True: "[bold]armed[/]: the pusher moves", False: "[bold]dry run[/]: nothing moves (--arm does)"}
    where = "a simulated arm" if options.simulate_arm else options.engine
    if options.engine == "lcm" and not options.simulate_arm:
        where = f"a robot at {setup.scenario.lcm.url}"
    console.print(f"{where}, {what[options.arm]}", highlight=False, soft_wrap=True)
    console.print(
        f"limits: {limits.max_speed:g} m/s, {limits.max_acceleration:g} m/s², images {limits.max_image_age:g} s old, "
        f"{_corner(limits.box_low)} to {_corner(limits.box_high)} m",
        highlight=False,
        soft_wrap=True,
    )


def _await_browser(console: Console, meshcat: Meshcat) -> None:
    """Says where the page is; on a terminal, waits a while for somebody to open it."""
    console.print(f"Meshcat is at {meshcat.web_url()}", highlight=False, soft_wrap=True)
    end = time.monotonic() + _PATIENCE
    while console.is_terminal and meshcat.GetNumActiveConnections() == 0 and time.monotonic() < end:
        time.sleep(0.1)


def _keep(console: Console) -> None:
    """Leaves the page up until Ctrl-C."""
    console.print("Ctrl-C ends")
    try:
        while True:
            time.sleep(1.0)
    except KeyboardInterrupt:
        return


def _corner(p: tuple[float, float, float]) -> str:
    return f"({', '.join(f'{x:g}' for x in p)})"


def _line(t: float, row: ControlRow, wall: float) -> str:
    """A line of status."""
    status, (x, y), p = row.status, 1e3 * row.raw_action, 1e3 * row.p_WP
    parts = [f"{t:6.2f} s  {status.state}"]
    parts.append("" if math.isnan(x) else f"action ({x:+.1f}, {y:+.1f}) mm{' cut' if status.limited else ''}")
    parts.append(f"pusher ({p[0]:+.1f}, {p[1]:+.1f}) mm")
    if not math.isnan(row.distance):
        parts.append(f"object {1e3 * row.distance:.1f} mm, {math.degrees(row.angle):.1f}° from the goal")
    if t > 0:
        parts.append(f"{t / max(wall, 1e-9):.2f} x real time")
    return "  ".join(part for part in [*parts, status.reason] if part)


def _conclude(console: Console, row: ControlRow, options: ControlOptions) -> None:
    if row.status.state == "latched":
        raise StateError(f"the pusher was stopped: {row.status.reason}")
    if not options.arm:
        console.print("dry run: nothing was moved")
    elif not math.isnan(row.distance):
        console.print("[green]at the goal[/]" if row.success else "[yellow]not at the goal[/]")
