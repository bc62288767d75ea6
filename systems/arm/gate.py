# SPDX-License-Identifier: MIT
"""Gate before a robot: commands of one session, in order and in time, or none.

A controller draws a random session when a person arms it. The gate opens for a session that it has never seen, and
takes its commands as long as their numbers go up and they have not expired, by the robot's own clock. Whatever else
comes latches it at rest until a person arms a controller anew.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from drake import lcmt_drake_signal  # type: ignore[import-untyped]  # LCM's types
from pydrake.common.value import AbstractValue
from pydrake.lcm import DrakeLcmInterface
from pydrake.systems.framework import Context, EventStatus, LeafSystem, State

from pinwm_drake.systems.engines.lcm.hearing import DRIVER_FAULTS, LATCHED, LIVE, WAITING
from pinwm_drake.systems.engines.lcm.messages import Mailbox, Tally
from pinwm_drake.systems.engines.lcm.seal import Seal
from pinwm_drake.systems.engines.lcm.signal import COMMAND_NAMES
from pinwm_drake.systems.ports import Immutable, declare_vector, unowned
from pinwm_drake.systems.scenario.schema import LcmLink

SECOND_SESSION, OLDER, EXPIRED, MALFORMED, TOO_FAST, FAST_JOINT = 1, 2, 3, 4, 5, 6  # of DRIVER_FAULTS
_SIZE = len(COMMAND_NAMES)
_SESSIONS = 256  # that are remembered; older ones have expired long since
_FASTER = 1.01  # times the largest speed, that rounding and a limiter may make of it
_SHARE = 1e-6  # of a time-out, by which times may be off


@dataclass(frozen=True)
class Gate(Immutable):
    """State of a gate.

    Attributes:
        mode: WAITING for a session, LIVE in one, or LATCHED by a fault.
        fault: Number of the fault in DRIVER_FAULTS; 0 where there is none.
        session: The open session; 0 where there is none.
        sequence: Number of its last command; -1 before the first.
        heard: s, when that came.
        velocity: (3,) m/s, world: v_WP that it asks for; zero unless live.
        used: The last 256 sessions that have been seen, the latest at the end.
    """

    mode: int = WAITING
    fault: int = 0
    session: int = 0
    sequence: int = -1
    heard: float = -math.inf
    velocity: tuple[float, ...] = (0.0, 0.0, 0.0)
    used: tuple[int, ...] = ()


def closed(gate: Gate, mode: int = WAITING, fault: int = 0) -> Gate:
    """Return the gate without a session, at rest."""
    return replace(gate, mode=mode, fault=fault, session=0, sequence=-1, velocity=(0.0, 0.0, 0.0))


def take_command(gate: Gate, values: list[float], now: float, link: LcmLink, max_speed: float) -> Gate:
    """Return the gate after a command.

    Args:
        gate: The gate before.
        values: Values of the message, as `CommandSender` sends them.
        now: s, robot's clock.
        link: Period and time-out.
        max_speed: m/s, largest speed of a command.
    """
    right = len(values) == _SIZE and all(map(math.isfinite, values)) and all(map(float.is_integer, values[3:5]))
    if not right:
        return closed(gate, LATCHED, MALFORMED) if gate.mode == LIVE else gate
    velocity, session, sequence, expiry = tuple(values[:3]), int(values[3]), int(values[4]), values[5]
    if session == 0:  # disarmed: stopping is safe, whoever asks for it
        return closed(gate) if gate.mode == LIVE else gate
    known = session in gate.used
    if gate.used[-1:] != (session,):
        used = (*(other for other in gate.used if other != session), session)
        gate = replace(gate, used=used[-_SESSIONS:])
    late = expiry < now or expiry > now + link.timeout + link.period
    if gate.mode != LIVE or session != gate.session:
        if gate.mode == LIVE:
            return closed(gate, LATCHED, SECOND_SESSION)
        if known or late:
            return gate
        gate = replace(closed(gate, LIVE), session=session)
    if sequence <= gate.sequence:
        return closed(gate, LATCHED, OLDER)
    if late:
        return closed(gate, LATCHED, EXPIRED)
    if math.hypot(*velocity) > _FASTER * max_speed:
        return closed(gate, LATCHED, TOO_FAST)
    return replace(gate, sequence=sequence, heard=now, velocity=velocity)


def pass_time(gate: Gate, now: float, timeout: float) -> Gate:
    """Return the gate at a time [s]: a session that was silent for longer than `timeout` is closed for good."""
    silent = gate.mode == LIVE and now - gate.heard > timeout * (1.0 + _SHARE)
    return closed(gate) if silent else gate


def watch_joints(gate: Gate, v: np.ndarray, fastest: np.ndarray) -> Gate:
    """Return the gate after a look at the joints; a joint that is faster than it may be latches it.

    Args:
        gate: The gate before.
        v: (n,) rad/s, velocities of the joints.
        fastest: (n,) rad/s, their greatest speeds.
    """
    too_fast = gate.mode == LIVE and not bool((np.abs(v) <= fastest).all())
    return closed(gate, LATCHED, FAST_JOINT) if too_fast else gate


class CommandGate(LeafSystem):  # type: ignore[misc]  # pydrake has no usable types
    """Gate before an arm's control.

        lcmt_drake_signal ┌─────────────┐─► pusher_velocity_W  (3) [m/s]: zero unless live
        on the channel ──►│ CommandGate │─► command_time       (1): s, of the last command; -1 before
        of commands       │             │─► status             (4): session, sequence, mode, fault
        joint_velocities ►└─────────────┘   (n) [rad/s], of the joints; this input is there with `fastest` alone

    The state, a `Gate`, is updated every `period` by all messages that have come since; there is no direct feedthrough.
    With a seal, a command that is not signed, comes again or is of another session than the open one is dropped and
    counted; without, it latches. An exception latches as well, and a joint that is faster than `fastest`.

    Args:
        lcm: LCM that the messages come through; somebody has to pump it.
        link: Channel, period and time-out.
        max_speed: m/s, largest speed of a command.
        tally: Counts commands that are not used.
        seal: Seal of this end; None where messages are not signed.
        fastest: (n,) rad/s, greatest speeds of the robot's joints; None where they are not watched.
    """

    def __init__(
        self,
        lcm: DrakeLcmInterface,
        link: LcmLink,
        max_speed: float,
        tally: Tally,
        seal: Seal | None = None,
        fastest: np.ndarray | None = None,
    ) -> None:
        super().__init__()
        self._fastest = fastest
        if fastest is not None:
            self._joints = self.DeclareVectorInputPort("joint_velocities", len(fastest))
        self._link, self._max_speed, self._tally, self._signed = link, max_speed, tally, seal is not None
        self._mailbox = Mailbox(link.command_channel, lcmt_drake_signal, lcm, tally, seal)
        self._gate = self.DeclareAbstractState(AbstractValue.Make(Gate()))
        self.DeclarePeriodicUnrestrictedUpdateEvent(link.period, 0.0, unowned(self, self._Update))
        held = {self.abstract_state_ticket(self._gate)}
        declare_vector(self, "pusher_velocity_W", 3, lambda context: self._get(context).velocity, held)
        declare_vector(self, "command_time", 1, lambda context: [max(self._get(context).heard, -1.0)], held)
        declare_vector(self, "status", 4, self._CalcStatus, held)

    def gate(self, context: Context) -> Gate:
        """State of the gate, by the context of this system or of the outermost diagram around it."""
        return self._get(self.GetMyContextFromRoot(context))

    def _get(self, context: Context) -> Gate:
        return context.get_abstract_state(int(self._gate)).get_value()

    def _Update(self, context: Context, state: State) -> EventStatus:
        gate, now = self._get(context), context.get_time()
        for message in self._mailbox.take():
            gate = self._taken(gate, message, now)
        gate = pass_time(gate, now, self._link.timeout)
        if self._fastest is not None:
            gate = watch_joints(gate, self._joints.Eval(context), self._fastest)
        state.get_mutable_abstract_state(int(self._gate)).set_value(gate)
        return EventStatus.Succeeded()

    def _taken(self, gate: Gate, message: lcmt_drake_signal, now: float) -> Gate:
        channel, values = self._link.command_channel, list(message.val) if message.dim >= 0 else []
        foreign = len(values) == _SIZE and gate.mode == LIVE and values[3] not in (0.0, float(gate.session))
        if self._signed and foreign:
            self._tally.note(channel, "of another session")
            return gate
        try:
            taken = take_command(gate, values, now, self._link, self._max_speed)
        except Exception as error:  # whatever somebody sent
            self._tally.note(channel, "cannot be handled", f"{type(error).__name__}: {error}")
            return closed(gate, LATCHED, MALFORMED)
        if taken.fault and (taken.mode, taken.fault) != (gate.mode, gate.fault):
            self._tally.note(channel, DRIVER_FAULTS[taken.fault])
        return taken

    def _CalcStatus(self, context: Context) -> list[int]:
        gate = self._get(context)
        return [gate.session, gate.sequence, gate.mode, gate.fault]
