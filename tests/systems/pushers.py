# SPDX-License-Identifier: MIT
"""A diagram of a system that moves a pusher, and a world that takes its velocity."""

import numpy as np
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import BasicVector, Context, DiagramBuilder, DiscreteValues, LeafSystem

PERIOD = 1 / 240


class Slider(LeafSystem):
    """Pushers without anything to push: samples pusher_velocity_W at k period and moves by it; out: pusher_state."""

    def __init__(self, start, period=PERIOD):
        super().__init__()
        start = np.asarray(start, float).reshape(-1, 3)
        self.period = period
        self.DeclareVectorInputPort("pusher_velocity_W", start.size)
        state = self.DeclareDiscreteState(BasicVector(np.hstack([start, np.zeros_like(start)]).ravel()))
        self.DeclareStateOutputPort("pusher_state", state)
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._Step)

    def _Step(self, context: Context, values: DiscreteValues) -> None:
        state = context.get_discrete_state_vector().CopyToVector().reshape(-1, 6)
        state[:, 3:] = self.get_input_port().Eval(context).reshape(-1, 3)
        state[:, :3] += self.period * state[:, 3:]
        values.get_mutable_vector().SetFromVector(state.ravel())


class Track:
    """A simulator of a pusher's system and a `Slider`; inputs of the former are exported."""

    def __init__(self, system, start, period=PERIOD):
        builder = DiagramBuilder()
        self.system = builder.AddSystem(system)
        self.slider = builder.AddSystem(Slider(start, period))
        builder.Connect(system.get_output_port(), self.slider.get_input_port())
        if system.num_input_ports():
            builder.ExportInput(system.get_input_port(), "in")
        builder.ExportOutput(self.slider.get_output_port(), "pusher_state")
        self.diagram = builder.Build()
        self.simulator = Simulator(self.diagram)
        self.context = self.simulator.get_mutable_context()

    def mine(self):
        return self.system.GetMyMutableContextFromRoot(self.context)

    def fix(self, value):
        self.diagram.get_input_port().FixValue(self.context, np.ravel(value))

    def position(self, t):
        """p_WP (W, 3) after all steps before t."""
        self.simulator.AdvanceTo(t)
        return self.diagram.get_output_port().Eval(self.context).reshape(-1, 6)[:, :3]
