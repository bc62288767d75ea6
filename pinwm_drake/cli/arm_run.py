"""What `pinwm arm` does."""

import logging
import math
import time
from dataclasses import dataclass

import numpy as np
from pydrake.systems.analysis import Simulator
from rich.console import Console

from pinwm_drake.cli.control_run import require, require_common
from pinwm_drake.systems.arm.driver import ArmDriver, MakeArmDriver
from pinwm_drake.systems.engines.lcm.link import make_lcm
from pinwm_drake.systems.envs.options import EnvOptions, environment_setup
from pinwm_drake.systems.scenario.load import load_setup, with_url
from pinwm_drake.systems.sdf.twin import contact_name
from pinwm_drake.systems.view.scene import make_meshcat

_EVERY = 1.0  # s, between lines
_SLOW = 0.9  # of real time


@dataclass(frozen=True)
class ArmOptions:
    """The options of `pinwm arm`, named and in units as there.

    Raises:
        ParameterError: One is out of range.
    """

    scene: str
    image_size: int | None
    contact: str
    duration: float
    seed: int
    lcm_url: str | None
    meshcat: bool
    port: int | None

    def __post_init__(self) -> None:
        """Checks every option."""
        require("--duration", self.duration, 0.1 <= self.duration <= 3600, "0.1 to 3600 s")
        fits = self.image_size is None or 8 <= self.image_size <= 4096
        require("--image-size", self.image_size, fits, "8 to 4096 px")
        require_common(self.contact, self.seed)


def run_arm(options: ArmOptions) -> None:
    """Simulates an arm that listens for commands, in real time.

    Args:
        options: The options.

    Raises:
        PinwmError: An input was refused.
    """
    console = Console()
    logging.getLogger("drake").setLevel(logging.WARNING)
    setup = with_url(
        environment_setup(load_setup(options.scene), EnvOptions(image_size=options.image_size)), options.lcm_url
    )
    meshcat = make_meshcat(port=options.port) if options.meshcat else None
    lcm = make_lcm(setup.scenario.lcm)
    driver = MakeArmDriver(setup, lcm, contact=contact_name(options.contact), meshcat=meshcat)
    simulator = Simulator(driver)
    simulator.set_target_realtime_rate(1.0)
    context = simulator.get_mutable_context()
    driver.SetPlace(context, driver.draw_place(np.random.default_rng(options.seed)))
    simulator.Initialize()
    if meshcat is not None:
        console.print(f"Meshcat is at {meshcat.web_url()}", highlight=False, soft_wrap=True)
    console.print(f"a simulated arm listens at {setup.scenario.lcm.url}; Ctrl-C ends", highlight=False, soft_wrap=True)
    began = time.perf_counter()
    try:
        for k in range(1, math.ceil(options.duration / _EVERY) + 1):
            simulator.AdvanceTo(min(k * _EVERY, options.duration))
            console.print(_line(driver, simulator, began), highlight=False, soft_wrap=True)
    except KeyboardInterrupt:
        console.print("ended")


def _line(driver: ArmDriver, simulator: Simulator, began: float) -> str:
    """A line of status."""
    context = simulator.get_context()
    tool, state = (driver.GetOutputPort(name).Eval(context) for name in ("pusher_state", "object_state"))
    t, speed = context.get_time(), float(np.hypot(*tool[3:5]))
    rate = t / (time.perf_counter() - began)
    slow = ": too slow, so that its images will be found stale" if rate < _SLOW else ""
    return (
        f"{t:6.1f} s  tool ({1e3 * tool[0]:+.1f}, {1e3 * tool[1]:+.1f}) mm, {1e3 * speed:.0f} mm/s  "
        f"object ({1e3 * state[4]:+.1f}, {1e3 * state[5]:+.1f}) mm  {rate:.2f} x real time{slow}"
    )
