# SPDX-License-Identifier: MIT
"""Vectors as messages, and addresses."""

import pytest
from drake import lcmt_drake_signal

from pinwm_drake.errors import ParameterError
from pinwm_drake.systems.engines.lcm.link import make_lcm
from pinwm_drake.systems.engines.lcm.signal import CommandSender, SignalSender
from pinwm_drake.systems.scenario.schema import LOCAL, LcmLink


def test_what_is_sent():
    sender = SignalSender(("vx", "vy"))
    context = sender.CreateDefaultContext()
    context.SetTime(0.25)
    sender.get_input_port().FixValue(context, [0.5, -1.5])
    message = lcmt_drake_signal.decode(sender.get_output_port().Eval(context).encode())
    assert (message.dim, list(message.val), message.coord, message.timestamp) == (2, [0.5, -1.5], ["vx", "vy"], 250000)


def test_a_command_has_a_session_a_number_and_an_end():
    link = LcmLink()
    sender = CommandSender(link)
    context = sender.CreateDefaultContext()
    context.SetTime(0.25)
    sender.GetInputPort("pusher_velocity").FixValue(context, [0.1, -0.2, 0.0])
    sender.GetInputPort("robot_time").FixValue(context, [1000.5])

    def values():
        return list(lcmt_drake_signal.decode(sender.get_output_port().Eval(context).encode()).val)

    # Without a session it does not move.
    assert values() == [0.0, 0.0, 0.0, 0.0, 50.0, pytest.approx(1000.5 + link.timeout)]
    session = (1 << 48) - 1
    sender.GetInputPort("session").FixValue(context, [session])
    assert values() == [0.1, -0.2, 0.0, session, 50.0, pytest.approx(1000.5 + link.timeout)]


@pytest.mark.parametrize("url", ["udpm://239.255.76.67:7667?ttl=1", "udpm://239.255.76.67:7667", "", "tcpq://host"])
def test_no_address_reaches_other_machines(url):
    with pytest.raises(ParameterError, match=r"lcm\.url: got .*; allowed: memq://"):
        make_lcm(LcmLink(url=url))


def test_the_default_stays_within_the_process():
    assert make_lcm(LcmLink()).get_lcm_url() == "memq://"
    assert LOCAL.endswith("ttl=0")
