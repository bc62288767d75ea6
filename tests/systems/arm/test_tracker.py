# SPDX-License-Identifier: MIT
import logging

import numpy as np
from pydrake.solvers import OsqpSolver
from pydrake.systems.analysis import Simulator

from pinwm_drake.learning.safety import SafetyLimits
from pinwm_drake.systems.arm import tracker
from pinwm_drake.systems.arm.model import ArmModel

PERIOD = 0.005


class Stuck(OsqpSolver):
    """Solver that finds nothing while it is told so."""

    stuck = False

    def Solve(self, program, *given):
        result = super().Solve(program, *given)
        if self.stuck:
            result.set_x_val(np.full(program.num_vars(), np.nan))
        return result


def test_without_a_plan_the_joints_brake_and_a_line_says_so_once(monkeypatch, caplog):
    monkeypatch.setattr(tracker, "OsqpSolver", Stuck)
    model = ArmModel(0.0, 0.1, "panda")
    limits = SafetyLimits((-0.3, -0.3, 0.02), (0.3, 0.3, 0.3), 1.25, 7.0, 0.2)
    system = tracker.JointTracker(model, limits, PERIOD, None)
    simulator = Simulator(system)
    context = simulator.get_mutable_context()
    tool = model.plant.CreateDefaultContext()
    model.plant.SetPositions(tool, model.nominal)
    p_WP = model.tool.CalcPoseInWorld(tool).translation()

    def goes(v_WP, seconds):
        system.GetInputPort("desired_state").FixValue(context, [*p_WP, *v_WP])
        system.GetInputPort("wanted").FixValue(context, v_WP)
        simulator.AdvanceTo(context.get_time() + seconds)
        return np.abs(system.get_output_port().Eval(context)[7:]).max()

    system.GetInputPort("robot_state").FixValue(context, [*model.nominal, *np.zeros(7)])
    with caplog.at_level(logging.WARNING, "drake"):
        assert goes([0.0, 0.2, 0.0], 0.05) > 0.05
        assert not caplog.records
        Stuck.stuck = True
        assert goes([0.0, 0.2, 0.0], 0.2) < 1e-4
        (line,) = caplog.messages
        assert line.startswith("JointTracker: no plan for angles [")
        assert line.endswith("; the joints brake")
        Stuck.stuck = False
        assert goes([0.0, 0.2, 0.0], 0.05) > 0.05
        assert len(caplog.records) == 1
