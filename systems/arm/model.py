# SPDX-License-Identifier: MIT
"""Model of the simulated driver's arm: its place, its drives, and the joint angles that bring its tool to a point."""

import math

import numpy as np
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix
from pydrake.multibody.inverse_kinematics import InverseKinematics
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import FixedOffsetFrame, Frame, ModelInstanceIndex
from pydrake.solvers import Solve

from pinwm_drake.errors import ParameterError
from pinwm_drake.models import model_path

JOINTS = 7
TOOL = "tool"  # frame at the end of the rod, with the world's axes when the rod points down
# m, x and y of the box that the tool may be in: what the arm reaches, elbow up, with its rod down.
REACH_LOW, REACH_HIGH = (-0.26, -0.22), (0.26, 0.22)
_FILE = "arm/iiwa14.sdf"
# m, the base beside the scene, across from the camera of push_t, and so high above the floor that the wrist is below
# the shoulder.
_BEHIND, _ABOVE = 0.43, 0.53
_YAW = -0.5 * math.pi
_GUESS = np.array([0.0, 1.54, 0.0, -1.57, 0.0, 0.03, 0.0])
_ANGLE = 1e-7  # rad, of the solution


def add_arm(plant: MultibodyPlant, floor_height: float) -> tuple[ModelInstanceIndex, Frame]:
    """Add the arm, on its pedestal, to a plant that is not finalized.

    It is free of gravity, which the controller of such an arm makes up for by itself.

    Args:
        plant: The plant.
        floor_height: m, world.

    Returns:
        Its model instance, and the frame `TOOL`.
    """
    parser = Parser(plant)
    parser.SetStrictParsing()
    (arm,) = parser.AddModels(str(model_path(_FILE)))
    X_WA = RigidTransform(RollPitchYaw(0.0, 0.0, _YAW), [0.0, _BEHIND, floor_height + _ABOVE])
    plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("base", arm), X_WA)
    plant.set_gravity_enabled(arm, False)
    X_tool = RigidTransform(RotationMatrix.MakeZRotation(-_YAW))
    return arm, plant.AddFrame(FixedOffsetFrame(TOOL, plant.GetFrameByName("tip", arm), X_tool))


class ArmModel:
    """Model of the arm alone, for its kinematics.

    Args:
        floor_height: Height of the floor, m, world.
        tool_height: Height at which the tool works, m, world.

    Attributes:
        plant: Finalized; in no diagram.
        tool: The frame `TOOL`.
        nominal: (7,) rad, joint angles with the tool in the middle of its reach, elbow up.
    """

    def __init__(self, floor_height: float, tool_height: float) -> None:
        self.plant = MultibodyPlant(0.0)
        _, self.tool = add_arm(self.plant, floor_height)
        self.plant.Finalize()
        self.nominal = _GUESS
        self.nominal = self.positions(np.array([0.0, 0.0, tool_height]))

    def positions(self, p_WP: np.ndarray) -> np.ndarray:
        """Joint angles (7,) rad, near the nominal ones, with the tool at p_WP (3,) m and the rod down.

        Raises:
            ParameterError: The place is out of reach.
        """
        p_WP = np.asarray(p_WP, float)
        inside = (np.array(REACH_LOW) <= p_WP[:2]).all() and (p_WP[:2] <= np.array(REACH_HIGH)).all()
        problem = InverseKinematics(self.plant)
        q, program, world = problem.q(), problem.prog(), self.plant.world_frame()
        problem.AddPositionConstraint(self.tool, np.zeros(3), world, p_WP, p_WP)
        problem.AddOrientationConstraint(world, RotationMatrix(), self.tool, RotationMatrix(), _ANGLE)
        program.AddQuadraticErrorCost(np.eye(JOINTS), self.nominal, q)
        program.SetInitialGuess(q, self.nominal)
        result = Solve(program)
        if not inside or not result.is_success():
            raise ParameterError(
                f"pusher: got {p_WP.round(3).tolist()} m, out of the arm's reach; allowed: x and y of "
                f"{list(REACH_LOW)} to {list(REACH_HIGH)} m, near the height of the task"
            )
        return np.asarray(result.GetSolution(q))
