"""Vectors through LCM and back."""

import numpy as np
import pytest
from drake import lcmt_drake_signal
from pydrake.lcm import DrakeLcm
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.lcm import LcmInterfaceSystem, LcmSubscriberSystem

from pinwm_drake.errors import ParameterError
from pinwm_drake.systems.engines.lcm.link import make_lcm
from pinwm_drake.systems.engines.lcm.signal import SignalReceiver, SignalSender
from pinwm_drake.systems.scenario.schema import LOCAL, LcmLink

CHANNEL, PERIOD, TIMEOUT = "TEST", 0.005, 0.02
FIRST = np.array([7.0, 8.0, 9.0])


class Ear:
    """A receiver of three values, and what it shows."""

    def __init__(self):
        self.lcm = DrakeLcm("memq://")
        builder = DiagramBuilder()
        builder.AddSystem(LcmInterfaceSystem(self.lcm))
        subscriber = builder.AddSystem(LcmSubscriberSystem.Make(CHANNEL, lcmt_drake_signal, self.lcm))
        self.receiver = builder.AddSystem(SignalReceiver(3, PERIOD, TIMEOUT, FIRST))
        builder.Connect(subscriber.get_output_port(), self.receiver.get_input_port())
        self.simulator = Simulator(builder.Build())

    def say(self, stamp: float, values: list[float]) -> None:
        message = lcmt_drake_signal()
        message.dim, message.val, message.coord = len(values), values, ["" for _ in values]
        message.timestamp = round(1e6 * stamp)
        self.lcm.Publish(CHANNEL, message.encode())

    def after(self, t: float) -> dict[str, np.ndarray]:
        self.simulator.AdvanceTo(t)
        mine = self.receiver.GetMyContextFromRoot(self.simulator.get_context())
        return {name: self.receiver.GetOutputPort(name).Eval(mine).copy() for name in ("values", "last", "time")}


def test_values_come_and_go():
    ear = Ear()
    before = ear.after(0.01)
    assert np.isnan(before["values"]).all()
    assert (before["last"] == FIRST).all()
    assert before["time"] == [-1.0]
    ear.say(3.0, [1.0, 2.0, 3.0])
    there = ear.after(0.03)
    assert (there["values"] == [1, 2, 3]).all()
    assert 0.01 <= there["time"][0] <= 0.01 + PERIOD + 1e-9
    gone = ear.after(0.05)
    assert np.isnan(gone["values"]).all()
    assert (gone["last"] == [1, 2, 3]).all()
    assert gone["time"] == there["time"]


def test_a_sender_that_repeats_itself_is_silent():
    ear = Ear()
    for k in range(10):
        ear.say(1.0, [1.0, 2.0, 3.0])
        shown = ear.after(0.01 * (k + 1))
    assert np.isnan(shown["values"]).all()


def test_a_message_of_another_size_is_none():
    ear = Ear()
    ear.say(1.0, [1.0, 2.0])
    assert np.isnan(ear.after(0.01)["values"]).all()
    ear.say(1.01, [1.0, np.nan, 3.0])
    np.testing.assert_array_equal(ear.after(0.02)["values"], [1.0, np.nan, 3.0])


def test_what_is_sent():
    sender = SignalSender(("vx", "vy"))
    context = sender.CreateDefaultContext()
    context.SetTime(0.25)
    sender.get_input_port().FixValue(context, [0.5, -1.5])
    message = lcmt_drake_signal.decode(sender.get_output_port().Eval(context).encode())
    assert (message.dim, list(message.val), message.coord, message.timestamp) == (2, [0.5, -1.5], ["vx", "vy"], 250000)


@pytest.mark.parametrize("url", ["udpm://239.255.76.67:7667?ttl=1", "udpm://239.255.76.67:7667", "", "tcpq://host"])
def test_no_address_reaches_other_machines(url):
    with pytest.raises(ParameterError, match=r"lcm\.url: got .*; allowed: memq://"):
        make_lcm(LcmLink(url=url))


def test_the_default_stays_within_the_process():
    assert make_lcm(LcmLink()).get_lcm_url() == "memq://"
    assert LOCAL.endswith("ttl=0")
