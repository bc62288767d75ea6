# SPDX-License-Identifier: MIT
import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import BasicVector, DiagramBuilder, LeafSystem

from pinwm_drake.systems.pusher.drive import PusherDrive
from pinwm_drake.systems.pusher.translation import PusherTranslation

PERIOD = 1 / 240  # s


class Follower(LeafSystem):
    """A pusher that is where it is told to be after each step of h."""

    def __init__(self, time_step):
        super().__init__()
        port = self.DeclareVectorInputPort("desired_state", 6)
        self.state = self.DeclareDiscreteState(BasicVector(np.zeros(6)))
        self.DeclareStateOutputPort("state", self.state)
        self.DeclarePeriodicDiscreteUpdateEvent(
            time_step, 0.0, lambda context, values: values.set_value(self.state, port.Eval(context))
        )


class Ramp(LeafSystem):
    """The velocity (t, 0, 0)."""

    def __init__(self):
        super().__init__()
        self.DeclareVectorOutputPort(
            "velocity",
            3,
            lambda context, output: output.SetFromVector([context.get_time(), 0, 0]),
            {self.time_ticket()},
        )


def driven(source, steps, start=(0.0, 0.0, 0.0)):
    """Source, drive, and what follows it with so many steps in a period."""
    step = (1 + 1e-12) * PERIOD / steps
    builder = DiagramBuilder()
    drive, follower = builder.AddSystem(PusherDrive(PERIOD, step, np.array(start))), builder.AddSystem(Follower(step))
    builder.Connect(drive.get_output_port(), follower.get_input_port())
    builder.ExportOutput(follower.get_output_port(), "state")
    if source is None:
        builder.ExportInput(drive.get_input_port(), "velocity")
    else:
        builder.Connect(builder.AddSystem(source).get_output_port(), drive.get_input_port())
        if source.num_input_ports():
            builder.ExportInput(source.get_input_port(), "input")
    return builder.Build(), drive


def state(diagram, simulator):
    return diagram.get_output_port().Eval(simulator.get_context())


@pytest.mark.parametrize("steps", [1, 7, 16])
def test_a_velocity_that_is_set_before_a_period_acts_from_its_beginning(steps):
    diagram, _ = driven(None, steps, start=[0.5, 0, 0.1])
    simulator = Simulator(diagram)
    context, generator, expected = simulator.get_mutable_context(), np.random.default_rng(0), np.array([0.5, 0, 0.1])
    # So many periods that k T and its steps are rounded to different numbers now and then.
    for k in range(500):
        v = generator.uniform(-1, 1, 3)
        diagram.get_input_port().FixValue(context, v)
        simulator.AdvanceTo((k + 1) * PERIOD)
        expected = expected + PERIOD * v
        # The last step is one of 1e-12 of the 2 s too late.
        np.testing.assert_allclose(state(diagram, simulator), [*expected, *v], rtol=0, atol=1e-11)


def test_a_velocity_is_held_between_samples():
    diagram, _ = driven(Ramp(), 16)
    simulator = Simulator(diagram)
    simulator.AdvanceTo(10 * PERIOD)
    # T (0 + 1 + ... + 9) T
    np.testing.assert_allclose(state(diagram, simulator)[[0, 3]], [45 * PERIOD**2, 9 * PERIOD], atol=1e-12)
    simulator.AdvanceTo(10.5 * PERIOD)
    assert state(diagram, simulator)[3] == pytest.approx(10 * PERIOD)


def test_a_source_that_samples_at_the_same_instant_is_not_late():
    diagram, _ = driven(PusherTranslation(1, 0.1, 1.0, PERIOD), 16)
    simulator = Simulator(diagram)
    moved = np.zeros(3)
    for k in range(5):
        d = np.array([0.01 * (k + 1), -0.02, 0.0])
        diagram.get_input_port().FixValue(simulator.get_mutable_context(), d)
        simulator.AdvanceTo(24 * (k + 1) * PERIOD)
        moved = moved + d
        np.testing.assert_allclose(state(diagram, simulator)[:3], moved, atol=1e-12)


def test_a_drive_that_is_put_elsewhere_rests_until_the_next_sample():
    diagram, drive = driven(None, 4)
    simulator = Simulator(diagram)
    context = simulator.get_mutable_context()
    diagram.get_input_port().FixValue(context, [1.0, 0.0, 0.0])
    simulator.AdvanceTo(2.5 * PERIOD)
    drive.SetPosition(drive.GetMyMutableContextFromRoot(context), np.array([0.0, 0.3, 0.0]))
    simulator.AdvanceTo(2.9 * PERIOD)
    np.testing.assert_allclose(state(diagram, simulator), [0, 0.3, 0, 0, 0, 0], atol=1e-12)
    simulator.AdvanceTo(4 * PERIOD)
    np.testing.assert_allclose(state(diagram, simulator), [PERIOD, 0.3, 0, 1, 0, 0], atol=1e-12)


def test_a_copy_of_the_context_goes_on_alike():
    diagram, _ = driven(None, 16)
    simulator = Simulator(diagram)
    context = simulator.get_mutable_context()
    diagram.get_input_port().FixValue(context, [0.1, 0.2, 0.3])
    simulator.AdvanceTo(3.3 * PERIOD)
    other = Simulator(diagram, context.Clone())
    for each in (simulator, other):
        each.AdvanceTo(7 * PERIOD)
    np.testing.assert_array_equal(state(diagram, simulator), state(diagram, other))
