# SPDX-License-Identifier: MIT
"""Models of the simulated driver's arms: their places, their drives, and the angles that bring a tool to a point."""

import math
from dataclasses import dataclass
from typing import Literal

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
ArmName = Literal["iiwa", "panda"]
_YAW = -0.5 * math.pi  # rad, of the base: it faces the scene, from across the camera
_ANGLE = 1e-7  # rad, of the solution


@dataclass(frozen=True)
class ArmKind:
    """Kind of an arm that can be simulated: what differs from one to another.

    Attributes:
        title: Maker and name.
        file: SDFormat file in `models`.
        behind, above: m: place of the base along y from the middle of the scene, and above the floor.
        guess: (7,) rad: joint angles with the tool near the middle, rod down.
        reach_low, reach_high: (2,) m: x and y of the box that the tool may be in, reached with the rod down.
        max_speed: m/s, of the tool; the scenario's may be less.
        max_acceleration: m/s^2, of the tool.
        swings: Flag: the rod may swing for speed, within the joints' limits of position, speed and acceleration. It
            always points down otherwise.
    """

    title: str
    file: str
    behind: float
    above: float
    guess: tuple[float, ...]
    reach_low: tuple[float, float]
    reach_high: tuple[float, float]
    max_speed: float
    max_acceleration: float
    swings: bool


ARMS: dict[ArmName, ArmKind] = {
    "iiwa": ArmKind(
        title="KUKA LBR iiwa 14",
        file="arm/iiwa14.sdf",
        behind=0.43,
        above=0.53,  # the wrist is below the shoulder
        guess=(0.0, 1.54, 0.0, -1.57, 0.0, 0.03, 0.0),
        reach_low=(-0.26, -0.22),
        reach_high=(0.26, 0.22),
        max_speed=math.inf,
        # 8.6 rad/s^2 of joint A1, which the notes of Drake's model of the arm give, at half a metre.
        max_acceleration=4.0,
        swings=False,
    ),
    "panda": ArmKind(
        title="Franka Emika Panda",
        file="arm/panda.sdf",
        behind=0.38,
        above=0.0,
        guess=(0.0, -0.4, 0.0, -2.3, 0.0, 1.9, 0.0),
        reach_low=(-0.26, -0.22),
        reach_high=(0.26, 0.22),
        max_speed=1.7,  # by the maker
        # What the joints have in every direction; the maker allows the tool 13 m/s^2.
        max_acceleration=7.0,
        swings=True,
    ),
}


def add_arm(plant: MultibodyPlant, floor_height: float, arm: ArmName = "iiwa") -> tuple[ModelInstanceIndex, Frame]:
    """Add an arm to a plant that is not finalized.

    It is free of gravity, which the controller of such an arm makes up for by itself.

    Args:
        plant: The plant.
        floor_height: m, world.
        arm: Name of the arm, of `ARMS`.

    Returns:
        Its model instance, and the frame `TOOL`.
    """
    parser = Parser(plant)
    parser.SetStrictParsing()
    kind = ARMS[arm]
    (instance,) = parser.AddModels(str(model_path(kind.file)))
    X_WA = RigidTransform(RollPitchYaw(0.0, 0.0, _YAW), [0.0, kind.behind, floor_height + kind.above])
    plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("base", instance), X_WA)
    plant.set_gravity_enabled(instance, False)
    X_tool = RigidTransform(RotationMatrix.MakeZRotation(-_YAW))
    return instance, plant.AddFrame(FixedOffsetFrame(TOOL, plant.GetFrameByName("tip", instance), X_tool))


class ArmModel:
    """Model of an arm alone, for its kinematics.

    Args:
        floor_height: Height of the floor, m, world.
        tool_height: Height at which the tool works, m, world.
        arm: Name of the arm, of `ARMS`.

    Attributes:
        kind: What the arm is.
        plant: Finalized; in no diagram.
        tool: The frame `TOOL`.
        nominal: (7,) rad, joint angles with the tool in the middle of its reach, elbow up.
    """

    def __init__(self, floor_height: float, tool_height: float, arm: ArmName = "iiwa") -> None:
        self.kind = ARMS[arm]
        self.plant = MultibodyPlant(0.0)
        _, self.tool = add_arm(self.plant, floor_height, arm)
        self.plant.Finalize()
        self.nominal = np.array(self.kind.guess)
        self.nominal = self.positions(np.array([0.0, 0.0, tool_height]))

    def positions(self, p_WP: np.ndarray) -> np.ndarray:
        """Joint angles (7,) rad, near the nominal ones, with the tool at p_WP (3,) m and the rod down.

        Raises:
            ParameterError: The place is out of reach.
        """
        p_WP = np.asarray(p_WP, float)
        low, high = self.kind.reach_low, self.kind.reach_high
        inside = (np.array(low) <= p_WP[:2]).all() and (p_WP[:2] <= np.array(high)).all()
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
                f"{list(low)} to {list(high)} m, near the height of the task"
            )
        return np.asarray(result.GetSolution(q))
