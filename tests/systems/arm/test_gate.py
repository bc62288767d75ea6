# SPDX-License-Identifier: MIT
"""Which commands move a robot, and what latches it."""

import numpy as np
import pytest

from pinwm_drake.systems.arm.gate import (
    EXPIRED,
    MALFORMED,
    OLDER,
    SECOND_SESSION,
    TOO_FAST,
    Gate,
    pass_time,
    take_command,
)
from pinwm_drake.systems.engines.lcm.hearing import DRIVER_FAULTS, LATCHED, LIVE, WAITING
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
