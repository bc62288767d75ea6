# SPDX-License-Identifier: MIT
"""Which commands move a robot, and what latches it."""

import numpy as np
import pytest
from pydrake.lcm import DrakeLcm
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.lcm import LcmInterfaceSystem

from pinwm_drake.systems.arm import gate as gate_module
from pinwm_drake.systems.arm.gate import (
    EXPIRED,
    FAST_JOINT,
    MALFORMED,
    OLDER,
    SECOND_SESSION,
    TOO_FAST,
    CommandGate,
    Gate,
    pass_time,
    take_command,
    watch_joints,
)
from pinwm_drake.systems.engines.lcm.hearing import DRIVER_FAULTS, LATCHED, LIVE, WAITING
from pinwm_drake.systems.engines.lcm.messages import Tally
from pinwm_drake.systems.engines.lcm.seal import Seal
from pinwm_drake.systems.engines.lcm.signal import COMMAND_NAMES, signal_message
from pinwm_drake.systems.scenario.schema import LcmLink

LINK, FASTEST, A, B, C = LcmLink(), 0.3, 11, 22, 33


def command(session, sequence, now, v=(0.1, 0.0, 0.0), age=0.0):
    return [*v, float(session), float(sequence), now - age + LINK.timeout]


def take(gate, values, now):
    return take_command(gate, values, now, LINK, FASTEST)


@pytest.fixture
def live():
    gate = take(Gate(), command(A, 100, 1.0), 1.0)
    assert (gate.mode, gate.session, gate.velocity) == (LIVE, A, (0.1, 0.0, 0.0))
    return gate


def is_latched(gate, fault):
    return (gate.mode, gate.fault, gate.session, gate.velocity) == (LATCHED, fault, 0, (0.0, 0.0, 0.0))


@pytest.mark.parametrize("v", [[0.0, -2.01], [np.nan, 0.0]])
def test_a_joint_that_is_too_fast_latches(live, v):
    fastest = np.array([1.0, 2.0])
    assert watch_joints(live, np.array([1.0, -2.0]), fastest) == live
    assert is_latched(watch_joints(live, np.array(v), fastest), FAST_JOINT)
    assert DRIVER_FAULTS[FAST_JOINT]
    # It may be moved by hand while nothing is commanded.
    assert watch_joints(Gate(), np.array(v), fastest) == Gate()


def test_commands_of_a_session_move_it_in_their_order(live):
    gate = take(live, command(A, 101, 1.005, (0.0, 0.2, 0.0)), 1.005)
    assert gate.velocity == (0.0, 0.2, 0.0)
    gate = take(gate, command(A, 140, 1.05, (0.05, 0.0, 0.0)), 1.05)
    assert (gate.mode, gate.sequence) == (LIVE, 140)
    # The same number again, and one that is none.
    assert is_latched(take(gate, command(A, 140, 1.05, (0.05, 0.0, 0.0)), 1.055), OLDER)
    assert is_latched(take(gate, command(A, 140.5, 1.05), 1.055), MALFORMED)


@pytest.mark.parametrize(
    ("values", "fault"),
    [
        (command(B, 5, 1.0), SECOND_SESSION),
        (command(A, 99, 1.0), OLDER),
        (command(A, 101, 1.0, age=0.2), EXPIRED),
        (command(A, 101, 1.0, age=-0.2), EXPIRED),
        (command(A, 101, 1.0, (np.nan, 0.0, 0.0)), MALFORMED),
        (command(A, np.inf, 1.0), MALFORMED),
        ([0.1, 0.0, 0.0], MALFORMED),
        ([], MALFORMED),
        (command(A, 101, 1.0, (0.0, 0.4, 0.0)), TOO_FAST),
    ],
)
def test_whatever_else_comes_latches_it_until_a_new_session(live, values, fault):
    gate = take(live, values, 1.0)
    assert is_latched(gate, fault)
    assert DRIVER_FAULTS[fault]
    # Neither the old session nor the other one goes on.
    for k in range(3):
        for session in (A, B) if fault == SECOND_SESSION else (A,):
            gate = take(gate, command(session, 200 + k, 1.1), 1.1)
            assert is_latched(gate, fault)
    gate = take(gate, command(C, 1, 1.2), 1.2)
    assert (gate.mode, gate.fault, gate.session) == (LIVE, 0, C)


def test_two_controllers_never_take_turns(live):
    gate, moved = live, []
    for k in range(50):
        now = 1.005 + 0.005 * k
        gate = take(gate, command(A, 101 + k, now), now)
        gate = take(gate, command(B, 7 + k, now, (-0.1, 0.0, 0.0)), now)
        moved.append(gate.velocity)
    assert set(moved) == {(0.0, 0.0, 0.0)}
    assert is_latched(gate, SECOND_SESSION)


def test_after_a_silence_it_waits_for_a_new_session(live):
    assert pass_time(live, 1.0 + LINK.timeout, LINK.timeout) == live
    gate = pass_time(live, 1.0 + LINK.timeout + LINK.period, LINK.timeout)
    assert (gate.mode, gate.session, gate.velocity) == (WAITING, 0, (0.0, 0.0, 0.0))
    for k in range(3):
        gate = take(gate, command(A, 300 + k, 1.2), 1.2)
        assert gate.mode == WAITING
    assert take(gate, command(B, 0, 1.3), 1.3).mode == LIVE


def test_a_queue_of_old_commands_opens_nothing():
    gate = Gate()
    for k in range(100):
        gate = take(gate, command(A, k, 5.0, age=5.0 - 0.005 * k), 5.0)
        assert gate.velocity == (0.0, 0.0, 0.0)
    assert gate.mode == WAITING


def test_a_disarmed_controller_closes_the_session_and_ends_no_fault(live):
    gate = take(live, command(0, 101, 1.0, (0.0, 0.0, 0.0)), 1.0)
    assert (gate.mode, gate.session, gate.velocity) == (WAITING, 0, (0.0, 0.0, 0.0))
    assert take(gate, command(A, 102, 1.01), 1.01).mode == WAITING
    latched = take(live, command(B, 1, 1.0), 1.0)
    assert take(latched, command(0, 102, 1.0), 1.0) == latched


def test_what_is_no_command_does_nothing_before_a_session():
    for values in ([], [0.1, 0.2, 0.3], command(A, 1, 1.0, (np.inf, 0, 0))):
        assert take(Gate(), values, 1.0).mode == WAITING


def test_the_sessions_that_it_remembers_are_bounded(live):
    gate, sizes = live, []
    for k in range(20_000):
        gate = take(gate, command(10_000 + k, 1, 1.0), 1.0)
        sizes.append(len(gate.used))
    assert max(sizes) == 256
    assert gate.used == tuple(range(29_744, 30_000))
    # A session that goes on is not forgotten for others that have come since.
    gate = live
    for k in range(400):
        gate = take(take(gate, command(1000 + k, 1, 1.0, age=9.0), 1.0), command(A, 200 + k, 1.0), 1.0)
        assert gate.session != A


KEY = bytes(range(32))
CHANNEL = LINK.command_channel


class Line:
    """A gate with a key, and those who send to it."""

    def __init__(self):
        self.lcm, self.tally = DrakeLcm("memq://"), Tally()
        self.driver, self.controller = Seal(KEY, bytes(16)), Seal(KEY)
        self.controller.verify("S", self.driver.sign("S", b""), adopt=True)
        builder = DiagramBuilder()
        builder.AddSystem(LcmInterfaceSystem(self.lcm))
        self.gate = builder.AddSystem(CommandGate(self.lcm, LINK, FASTEST, self.tally, self.driver))
        self.simulator = Simulator(builder.Build())
        self.context = self.simulator.get_context()

    def message(self, session, v=(0.1, 0.0, 0.0)):
        now = self.context.get_time()
        values = [*v, float(session), round(now / LINK.period), now + LINK.timeout]
        return signal_message(COMMAND_NAMES, np.array(values), now).encode()

    def send(self, *messages):
        """Sends messages, and gives the gate after them."""
        for message in messages:
            self.lcm.Publish(CHANNEL, message)
        self.simulator.AdvanceTo(self.context.get_time() + 2 * LINK.period)
        return self.gate.gate(self.context)

    def sign(self, message):
        return self.controller.sign(CHANNEL, message)


def test_with_a_key_no_third_process_moves_the_arm_or_stops_it():
    line = Line()
    # Before anybody has armed it.
    gate = line.send(line.message(A), Seal(bytes(32), bytes(16)).sign(CHANNEL, line.message(A)))
    assert (gate.mode, gate.used) == (WAITING, ())
    past = line.sign(line.message(A))
    assert line.send(past).velocity == (0.1, 0.0, 0.0)
    # In a session, with all that there is on the wire: forged, zero, garbage, replayed, and changed.
    for k in range(1, 30):
        now = line.sign(line.message(A, (0.1, 0.001 * k, 0.0)))
        changed = now[:-1] + bytes([now[-1] ^ 1])
        forged = line.message(B, (-0.2, 0.0, 0.0)), line.message(0, (0.0, 0.0, 0.0)), line.message(A, (0.0, 0.3, 0.0))
        gate = line.send(*forged, b"garbage", b"", past, now, now, past, changed, *forged)
        assert (gate.mode, gate.session, gate.velocity) == (LIVE, A, (0.1, 0.001 * k, 0.0))
        past = now
    assert gate.used == (A,)
    assert line.tally.counts == {"not signed with the key": 2 + 29 * 9, "replayed or out of order": 29 * 3}


def test_with_a_key_a_session_is_not_taken_over():
    line = Line()
    line.send(line.sign(line.message(A)))
    gate = line.send(line.sign(line.message(B, (-0.2, 0.0, 0.0))), line.sign(line.message(A)))
    assert (gate.mode, gate.session, gate.velocity) == (LIVE, A, (0.1, 0.0, 0.0))
    assert line.tally.counts == {"of another session": 1}
    # Whoever has the key may stop it, and what it stopped with moves nothing when it comes again.
    stop = line.sign(line.message(0, (0.0, 0.0, 0.0)))
    assert line.send(stop).mode == WAITING
    assert line.send(line.sign(line.message(C))).session == C
    assert line.send(stop, line.sign(line.message(C))).session == C


def test_a_recorded_run_moves_nothing_after_the_driver_began_anew():
    line, again = Line(), Line()
    again.driver._run = bytes(range(16))
    recorded = []
    for _ in range(10):
        recorded.append(line.sign(line.message(A)))
        assert line.send(recorded[-1]).mode == LIVE
    # The clock of the arm begins at 0 again: none of these has expired.
    for message in recorded:
        assert again.send(message).mode == WAITING
    assert again.tally.counts == {"of another run of the driver": 10}


def test_without_a_key_what_latches_it_is_counted():
    line = Line()
    gate = CommandGate(line.lcm, LINK, FASTEST, tally := Tally())
    simulator = Simulator(gate)
    context = simulator.get_context()
    for message in (line.message(A), line.message(B)):
        line.lcm.Publish(CHANNEL, message)
    line.lcm.HandleSubscriptions(0)
    simulator.AdvanceTo(LINK.period)
    assert is_latched(gate.gate(context), SECOND_SESSION)
    assert tally.counts == {"commands of two sessions came": 1}


def test_an_exception_in_the_gate_latches_it(monkeypatch):
    line = Line()
    assert line.send(line.sign(line.message(A))).mode == LIVE

    def fail(*_):
        raise RuntimeError("on purpose")

    with monkeypatch.context() as patch:
        patch.setattr(gate_module, "take_command", fail)
        assert is_latched(line.send(line.sign(line.message(A))), MALFORMED)
    assert line.tally.line(0.0).endswith("RuntimeError: on purpose")
    assert is_latched(line.send(line.sign(line.message(A))), MALFORMED)
