# SPDX-License-Identifier: MIT
"""Check of a simulated arm: whether its tool follows the motions that a policy makes."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from pydrake.math import RigidTransform
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import LogVectorOutput, VectorLogSink

from pinwm_drake.control.velocity_limiter import VelocityLimiter
from pinwm_drake.errors import ParameterError
from pinwm_drake.learning.contract import FOLLOWED, ArmCheck
from pinwm_drake.learning.safety import SafetyLimits
from pinwm_drake.systems.arm.driver import TIME_STEP, ArmDriver
from pinwm_drake.systems.arm.model import ARMS, ArmName
from pinwm_drake.systems.engines.lcm.link import make_lcm
from pinwm_drake.systems.engines.lcm.signal import COMMAND_NAMES, signal_message
from pinwm_drake.systems.scenario.schema import MEMORY
from pinwm_drake.systems.scenario.setup import Setup
from pinwm_drake.systems.scenario.start import Place

_EVERY, _VALID = 0.01, 0.1  # s: a command is sent again, and holds
_STILL = 1e-3  # m: less is no motion
_AWAY = RigidTransform([0.0, 2.0, 0.1])  # of the object: nothing is touched


@dataclass(frozen=True, eq=False)
class ToolMotion:
    """Motion that a tool is to make.

    Attributes:
        p_WP: (3,) m, world: its start, at rest.
        v_WP: (n, 3) m/s, world: velocity asked for in each action.
        horizon: s, of an action.
    """

    p_WP: np.ndarray
    v_WP: np.ndarray
    horizon: float


class CommandedArm:
    """A simulated arm in a scene without touch, which gets velocities for its tool.

    Args:
        setup: The scene.
        arm: Name of the arm, of `ARMS`.

    Attributes:
        driver: The driver.
        context: Its root context.
        logs: Logs of the tool's state and of the joints', at each step of the plant.

    Raises:
        InputError: A mesh cannot be used.
        ParameterError: The scene is out of the arm's reach.
    """

    def __init__(self, setup: Setup, arm: ArmName) -> None:
        # One process, no image.
        self._link = replace(setup.scenario.lcm, url=MEMORY, key_file=None, image_period=10.0)
        setup = replace(setup, scenario=replace(setup.scenario, lcm=self._link))
        self._lcm, builder, self._sent = make_lcm(self._link), DiagramBuilder(), 0
        self.driver = builder.AddSystem(ArmDriver(setup, self._lcm, arm=arm, contact="point"))
        names = ("pusher_state", "arm_state")
        self.logs: list[VectorLogSink] = [
            LogVectorOutput(self.driver.GetOutputPort(name), builder, TIME_STEP) for name in names
        ]
        self._simulator = Simulator(builder.Build())
        self.context = self._simulator.get_mutable_context()
        self._mine = self.driver.GetMyContextFromRoot(self.context)

    def begin(self, p_WP: np.ndarray) -> None:
        """Put the tool to p_WP (3,) m, world, at rest; raises ParameterError where the arm cannot reach it."""
        self.driver.SetPlace(self.context, Place(_AWAY, np.asarray(p_WP, float)))
        self._simulator.Initialize()

    def act(self, v_WP: np.ndarray, duration: float, each: Callable[[], None] = lambda: None) -> None:
        """Ask for a velocity (3,) m/s for a duration [s]; `each` is called every 0.01 s."""
        for _ in range(round(duration / _EVERY)):
            values = np.array([*v_WP, 1, self._sent, _EVERY * self._sent + _VALID])
            message = signal_message(COMMAND_NAMES, values, _EVERY * self._sent)
            self._lcm.Publish(self._link.command_channel, message.encode())
            self._sent += 1
            self._simulator.AdvanceTo(_EVERY * self._sent)
            each()

    @property
    def tool(self) -> np.ndarray:
        """Place (3,) [m] and velocity (3,) [m/s] of the tool, world."""
        return np.asarray(self.driver.GetOutputPort("pusher_state").Eval(self._mine))

    @property
    def target(self) -> np.ndarray:
        """The same, as commanded and limited by the driver; of the last period."""
        return np.asarray(self.driver.GetOutputPort("tool_target").Eval(self._mine))


def check_arm(arm: ArmName, setup: Setup, limits: SafetyLimits, motions: Sequence[ToolMotion]) -> ArmCheck:
    """Check in simulation whether an arm follows motions as a pusher does that has the limits alone.

    The arm gets the velocities of that pusher, as a controller sends them, in the box that it reaches. What counts is
    the way of each action: a policy sees where the tool is after it.

    Args:
        arm: Name of the arm.
        setup: The scene, without touch.
        limits: Limits of the pusher's motion that a controller keeps.
        motions: The motions.

    Raises:
        InputError: A mesh cannot be used.
    """
    title, errors, ways, away = ARMS[arm].title, list[np.ndarray](), list[np.ndarray](), "no motion"
    try:
        driven = CommandedArm(setup, arm)
    except ParameterError as error:
        return ArmCheck(arm, title, False, None, str(error))
    reached = driven.driver.limits
    limiter = VelocityLimiter(replace(limits, box_low=reached.box_low, box_high=reached.box_high), _EVERY)
    for motion in motions:
        try:
            driven.begin(motion.p_WP)
        except ParameterError as error:
            away = str(error)
            continue
        for asked, made in _ways(driven, motion, limiter):
            ways.append(asked)
            errors.append(made - asked)
    if not errors:
        return ArmCheck(arm, title, False, None, away)
    reason = limits.shortfall(reached) or "its limits are no less than the policy's"
    share = round(float(np.linalg.norm(errors)) / max(float(np.linalg.norm(ways)), _STILL), 3)
    return ArmCheck(arm, title, share <= FOLLOWED, share, reason)


def _ways(
    driven: CommandedArm, motion: ToolMotion, limiter: VelocityLimiter
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Ways (3,) [m] of each action: of a pusher that a limiter alone holds back, and of the tool."""
    p, v = driven.tool[:3], np.zeros(3)
    for wanted in motion.v_WP:
        before, start = driven.tool[:3], p
        for _ in range(round(motion.horizon / _EVERY)):
            v = limiter.limit(wanted, v, p)
            p = p + _EVERY * v
            driven.act(v, _EVERY)
        yield p - start, driven.tool[:3] - before
