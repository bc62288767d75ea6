"""`pinwm arm`: options, and lines of the state of a simulated arm."""

import logging
import math
import time
from typing import TYPE_CHECKING, Annotated

import typer

from pinwm_drake.cli.console import say
from pinwm_drake.cli.control import CONTACT, SCENE, URL, require_common
from pinwm_drake.cli.stopping import stop_signals
from pinwm_drake.errors import require

if TYPE_CHECKING:
    from pydrake.systems.analysis import Simulator

    from pinwm_drake.systems.arm.driver import ArmDriver

_EVERY = 1.0  # s, between lines
_LOOK = 0.05  # s, between looks for a wish to stop
_SLOW = 0.9  # pace, in units of real time, below which a line warns


def arm(
    bundle: Annotated[
        str, typer.Argument(metavar="BUNDLE", help="Bundle that is to control it, which tells the size of images.")
    ] = "push_t",
    scene: Annotated[str | None, typer.Option(help=SCENE, show_default="that of the bundle's task and object")] = None,
    image_size: Annotated[
        int | None, typer.Option(help="px, of images, as the policy sees them.", show_default="the bundle's")
    ] = None,
    latency: Annotated[float, typer.Option(help="s, between an image's exposure and its arrival, 0 to 1.")] = 0.0,
    contact: Annotated[str, typer.Option(help=CONTACT)] = "point",
    duration: Annotated[float, typer.Option(help="s, 0.1 to 3600.")] = 60.0,
    seed: Annotated[int, typer.Option(help="Of where object and pusher start, 0 or more.")] = 0,
    lcm_url: Annotated[str | None, typer.Option(help=URL, show_default="that of the scenario")] = None,
    meshcat: Annotated[bool, typer.Option("--meshcat", help="Show it in the browser, on this machine.")] = False,
    port: Annotated[
        int | None, typer.Option(help="Port of Meshcat to listen on.", show_default="first free from 7000")
    ] = None,
) -> None:
    """Simulates an arm in real time for `pinwm control --engine lcm` in another terminal."""
    import numpy as np
    from pydrake.systems.analysis import Simulator

    from pinwm_drake.learning.bundle import read_bundle
    from pinwm_drake.systems.arm.driver import MakeArmDriver
    from pinwm_drake.systems.engines.lcm.link import make_lcm
    from pinwm_drake.systems.envs.options import EnvOptions, environment_setup
    from pinwm_drake.systems.envs.policy_scene import usual_scene
    from pinwm_drake.systems.scenario.load import load_setup, with_url
    from pinwm_drake.systems.sdf.twin import contact_name
    from pinwm_drake.systems.view.meshcat import make_meshcat

    require("--duration", duration, 0.1 <= duration <= 3600, "0.1 to 3600 s")
    require("--image-size", image_size, image_size is None or 8 <= image_size <= 4096, "8 to 4096 px")
    require("--latency", latency, 0.0 <= latency <= 1.0, "0 to 1 s")
    require_common(contact, seed)
    spec = read_bundle(bundle).spec
    size = spec.camera.width if image_size is None else image_size
    logging.getLogger("drake").setLevel(logging.WARNING)
    setup = with_url(environment_setup(load_setup(scene or usual_scene(spec)), EnvOptions(image_size=size)), lcm_url)
    page = make_meshcat(port=port) if meshcat else None
    lcm = make_lcm(setup.scenario.lcm)
    driver = MakeArmDriver(setup, lcm, contact=contact_name(contact), latency=latency, meshcat=page)
    simulator = Simulator(driver)
    simulator.set_target_realtime_rate(1.0)
    context = simulator.get_mutable_context()
    driver.SetPlace(context, driver.draw_place(np.random.default_rng(seed)))
    simulator.Initialize()
    if page is not None:
        say(f"Meshcat is at {page.web_url()}")
    say(f"a simulated arm listens at {setup.scenario.lcm.url}; Ctrl-C ends")
    began, due = time.perf_counter(), _EVERY
    with stop_signals() as stop:
        stop.defer()
        while context.get_time() < duration - 1e-9 and not stop():
            simulator.AdvanceTo(min(context.get_time() + _LOOK, duration))
            if context.get_time() >= min(due, duration) - 1e-9:
                say(_line(driver, simulator, began))
                due += _EVERY
    say(f"ended by {stop()}" if stop() else "ended")
    if stop():
        raise SystemExit(stop.exit_code)


def _line(driver: "ArmDriver", simulator: "Simulator", began: float) -> str:
    """Line of the arm's state: time, tool, object, and pace."""
    context = simulator.get_context()
    tool, state = (driver.GetOutputPort(name).Eval(context) for name in ("pusher_state", "object_state"))
    t, speed = context.get_time(), math.hypot(*tool[3:5])
    rate = t / (time.perf_counter() - began)
    slow = ": too slow, so that its images will be found stale" if rate < _SLOW else ""
    return (
        f"{t:6.1f} s  tool ({1e3 * tool[0]:+.1f}, {1e3 * tool[1]:+.1f}) mm, {1e3 * speed:.0f} mm/s  "
        f"object ({1e3 * state[4]:+.1f}, {1e3 * state[5]:+.1f}) mm  {rate:.2f} x real time{slow}"
    )
