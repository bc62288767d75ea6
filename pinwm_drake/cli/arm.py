# SPDX-License-Identifier: MIT
"""`pinwm arm`: lines of the state of a simulated arm."""

import logging
import math
import time
from typing import TYPE_CHECKING

from pinwm_drake.cli.console import say
from pinwm_drake.cli.stopping import stop_signals
from pinwm_drake.experiments.requests.control import ArmRequest

if TYPE_CHECKING:
    from pydrake.systems.analysis import Simulator

    from pinwm_drake.systems.arm.driver import ArmDriver

_EVERY = 1.0  # s, between lines
_LOOK = 0.05  # s, between looks for a wish to stop
_SLOW = 0.9  # pace, in units of real time, below which a line warns


def arm(request: ArmRequest) -> None:
    """Simulate an arm in real time for `pinwm control`.

    Start `pinwm control --engine lcm` in another terminal.
    """
    import numpy as np
    from pydrake.systems.analysis import Simulator

    from pinwm_drake.learning.bundle import read_bundle
    from pinwm_drake.systems.arm.driver import ArmDriver
    from pinwm_drake.systems.engines.lcm.link import make_lcm
    from pinwm_drake.systems.envs.options import EnvOptions, environment_setup
    from pinwm_drake.systems.envs.policy_scene import policy_setup
    from pinwm_drake.systems.scenario.load import with_url
    from pinwm_drake.systems.sdf.twin import contact_name
    from pinwm_drake.systems.view.meshcat import make_meshcat

    found = read_bundle(request.bundle)
    spec = found.spec
    size = request.image_size or spec.camera.width
    logging.getLogger("drake").setLevel(logging.WARNING)
    setup = policy_setup(spec, found.provenance, request.bundle, request.scene, None)
    setup = with_url(environment_setup(setup, EnvOptions(image_size=size)), request.lcm_url, request.key)
    page = make_meshcat(port=request.port) if request.meshcat else None
    lcm = make_lcm(setup.scenario.lcm)
    driver = ArmDriver(
        setup,
        lcm,
        arm=request.arm_model,
        contact=contact_name(request.contact),
        latency=request.latency,
        meshcat=page,
    )
    simulator = Simulator(driver)
    simulator.set_target_realtime_rate(1.0)
    context = simulator.get_mutable_context()
    driver.SetPlace(context, driver.draw_place(np.random.default_rng(request.seed)))
    simulator.Initialize()
    if page is not None:
        say(f"Meshcat is at {page.web_url()}")
    say(f"a simulated arm listens at {setup.scenario.lcm.url}; Ctrl-C ends")
    began, due = time.perf_counter(), _EVERY
    with stop_signals() as stop:
        stop.defer()
        while context.get_time() < request.duration - 1e-9 and not stop():
            simulator.AdvanceTo(min(context.get_time() + _LOOK, request.duration))
            if context.get_time() >= min(due, request.duration) - 1e-9:
                say(_line(driver, simulator, began))
                due += _EVERY
            if line := driver.tally.line(time.monotonic()):
                say(line)
    if line := driver.tally.line(math.inf):
        say(line)
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
