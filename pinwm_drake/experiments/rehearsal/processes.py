# SPDX-License-Identifier: MIT
"""Processes of a rehearsal beside the controller's: the simulated arm, and a relay between the two that brings faults.

Arm and relay speak on channels of their own; controller and relay on those of the scenario.
"""

import contextlib
import heapq
import os
import signal
import time
from collections import deque
from dataclasses import dataclass, field, replace
from multiprocessing.connection import Connection
from typing import Any

import numpy as np
from drake import lcmt_drake_signal  # type: ignore[import-untyped]  # LCM's types

from pinwm_drake.experiments.rehearsal.faults import STALL, Disturb, kind_of
from pinwm_drake.systems.arm.model import ArmName
from pinwm_drake.systems.scenario.schema import LcmLink
from pinwm_drake.systems.scenario.setup import Setup

_TIME_STEP = 0.005  # s, of the arm's plant in a push: it takes 0.56 of a core, and with 0.0025 s 0.73
_PAST = 300  # messages of a channel that are remembered
CHANNELS = ("command", "state", "image")


def robot_link(link: LcmLink) -> LcmLink:
    """Link between arm and relay: that of the scenario with other channels."""
    return replace(
        link,
        command_channel=f"{link.command_channel}_ROBOT",
        state_channel=f"{link.state_channel}_ROBOT",
        image_channel=f"{link.image_channel}_ROBOT",
    )


def with_link(setup: Setup, link: LcmLink) -> Setup:
    """Return the setup with another link."""
    return replace(setup, scenario=replace(setup.scenario, lcm=link))


def run_arm(pipe: Connection, setup: Setup, latency: float, arm: ArmName) -> None:
    """Simulate the arm in real time until its pipe closes; a seed that comes through puts things into place anew.

    Args:
        pipe: Pipe to the rehearsal: seeds in; after each, the place's object pose (7,) out: q_WO, p_WO. None asks for
            the present state of the object (13,) and the tool's speed [m/s].
        setup: The scene, with the link to the relay.
        latency: s, of the camera.
        arm: Name of the arm, of `ARMS`.
    """
    from pydrake.systems.analysis import Simulator

    from pinwm_drake.systems.arm.driver import ArmDriver, moves_up
    from pinwm_drake.systems.engines.lcm.link import make_lcm

    _ignore_ctrl_c()
    lcm = make_lcm(setup.scenario.lcm)
    time_step = None if moves_up(setup) else _TIME_STEP
    driver = ArmDriver(setup, lcm, arm=arm, contact="point", time_step=time_step, latency=latency)
    simulator = Simulator(driver)
    context = simulator.get_mutable_context()
    driver.SetPlace(context, driver.draw_place(np.random.default_rng(0)))
    simulator.Initialize()
    began = time.monotonic()

    def advance() -> None:
        simulator.AdvanceTo(context.get_time() + _TIME_STEP)
        # Of Drake's own pace the clock would stand still while things are put into place.
        time.sleep(max(began + context.get_time() - time.monotonic(), 0.0))

    with contextlib.suppress(EOFError, OSError):
        while True:
            advance()
            if not pipe.poll():
                continue
            seed = pipe.recv()
            if seed is not None:
                driver.SetPlace(context, driver.draw_place(np.random.default_rng(seed)))
                simulator.Initialize()
                shown = time.monotonic() - began + latency + setup.scenario.lcm.image_period
                while context.get_time() < shown:  # placing took a while, and images of before are still under way
                    advance()
            state = driver.GetOutputPort("object_state").Eval(context)
            tool = driver.GetOutputPort("pusher_state").Eval(context)
            pipe.send((np.array(state), float(np.linalg.norm(tool[3:5]))))


@dataclass
class Traffic:
    """Commands that a controller has sent since the last order, as the relay has seen them.

    Attributes:
        begun: Time of the fault, s, monotonic; NaN before it.
        moved: Time of the last command that moves the robot, s, monotonic; NaN where there was none.
        last: The last command's values.
        robot: The last state that the robot itself sent.
        rest: Time since which the robot itself has been at rest, s, monotonic; NaN while it moves.
    """

    begun: float = float("nan")
    moved: float = float("nan")
    last: list[float] = field(default_factory=list)
    robot: list[float] = field(default_factory=list)
    rest: float = float("nan")


class Relay:
    """Relay of messages between a robot and a controller, which disturbs one channel when it is told to."""

    def __init__(self, link: LcmLink, controller: int) -> None:
        """Listen on both sides.

        Args:
            link: Link to the controller; that to the robot is `robot_link` of it.
            controller: Number of the controller's process, which may be stopped for a while.
        """
        from pinwm_drake.systems.engines.lcm.link import make_lcm

        self._lcm, self._controller = make_lcm(link), controller
        self.traffic, self._disturb = Traffic(), dict[str, Disturb]()
        self._past: dict[str, deque[bytes]] = {name: deque(maxlen=_PAST) for name in CHANNELS}
        self._waiting: list[tuple[float, int, str, bytes]] = []
        self._sent = 0
        theirs = robot_link(link)
        for name in CHANNELS:
            here, there = getattr(link, f"{name}_channel"), getattr(theirs, f"{name}_channel")
            source, target = (here, there) if name == "command" else (there, here)
            self._lcm.Subscribe(source, self._handler(name, target))

    def spin(self) -> None:
        """Pass messages on for a millisecond or two."""
        self._lcm.HandleSubscriptions(1)
        now = time.monotonic()
        while self._waiting and self._waiting[0][0] <= now:
            _, _, target, message = heapq.heappop(self._waiting)
            self._lcm.Publish(target, message)

    def begin(self, name: str) -> None:
        """Begins a fault, by its name."""
        kind = kind_of(name)
        self.traffic.begun = time.monotonic()
        if kind.make is not None:
            self._disturb = {kind.channel: kind.make(list(self._past[kind.channel]))}
        elif kind.channel == "process":
            os.kill(self._controller, signal.SIGSTOP)
            time.sleep(STALL)
            os.kill(self._controller, signal.SIGCONT)

    def clear(self) -> None:
        """End a fault, and forget all messages."""
        self._disturb, self._waiting, self.traffic = {}, [], Traffic()
        for past in self._past.values():
            past.clear()

    def _handler(self, name: str, target: str) -> Any:
        def handle(message: bytes) -> None:
            self._note(name, message)
            disturb = self._disturb.get(name)
            for delay, passed in [(0.0, message)] if disturb is None else disturb(message):
                if delay == 0.0:
                    self._lcm.Publish(target, passed)
                else:
                    self._sent += 1
                    heapq.heappush(self._waiting, (time.monotonic() + delay, self._sent, target, passed))

        return handle

    def _note(self, name: str, message: bytes) -> None:
        self._past[name].append(message)
        traffic, now = self.traffic, time.monotonic()
        if name == "command":
            traffic.last = list(lcmt_drake_signal.decode(message).val)
            if any(traffic.last[:3]):
                traffic.moved = now
        elif name == "state":
            traffic.robot = list(lcmt_drake_signal.decode(message).val)
            still = float(np.linalg.norm(traffic.robot[3:6])) < 1e-3  # m/s
            traffic.rest = float("nan") if not still else traffic.rest if traffic.rest == traffic.rest else now


def run_relay(pipe: Connection, link: LcmLink, controller: int) -> None:
    """Run a relay until its pipe closes.

    Args:
        pipe: Pipe to the rehearsal: ("begin", name, seconds from now), "end" of what has not begun, "clear" or "tell"
            in; `Traffic` out after each.
        link: Link to the controller.
        controller: Number of the controller's process.
    """
    _ignore_ctrl_c()
    relay, due = Relay(link, controller), ("", float("inf"))
    with contextlib.suppress(EOFError, OSError):
        while True:
            relay.spin()
            if time.monotonic() >= due[1]:
                relay.begin(due[0])
                due = ("", float("inf"))
            if not pipe.poll():
                continue
            order = pipe.recv()
            if order in ("clear", "end"):
                due = ("", float("inf"))
                if order == "clear":
                    relay.clear()
            elif order != "tell":
                due = (order[1], time.monotonic() + order[2])
            pipe.send(relay.traffic)


def _ignore_ctrl_c() -> None:
    """Leaves Ctrl-C to the process that started this one, which closes the pipe."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
