"""The pushing scene with an arm: a MultibodyPlant in which the pusher is the arm's tool."""

import dataclasses
from dataclasses import dataclass

from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import ModelInstanceIndex, PdControllerGains, RigidBody
from pydrake.systems.framework import DiagramBuilder

from pinwm_drake.systems.arm_model import JOINTS, add_arm
from pinwm_drake.systems.push_plant import MakePushPlant, PushPlant
from pinwm_drake.systems.setup import Setup
from pinwm_drake.systems.twin_model import ContactName

# N m/rad and N m s/rad of each joint's servo, which Drake's discrete solvers treat implicitly: a tool that is pushed
# with 1 N gives way by a hundredth of a millimetre.
_STIFFNESS, _DAMPING = 4e4, 8e2


@dataclass(frozen=True, eq=False)
class ArmPlant:
    """The parts of a pushing scene with an arm.

    Attributes:
        parts: Object, pusher, plant and scene graph; the pusher has no joints of its own.
        arm: Model instance of the arm: positions (7) [rad], velocities (7) [rad/s]. The plant's input port for its
            desired state has both.
    """

    parts: PushPlant
    arm: ModelInstanceIndex


def MakeArmPlant(
    builder: DiagramBuilder, setup: Setup, time_step: float, contact: ContactName = "hydroelastic"
) -> ArmPlant:
    """Adds a finalized plant, and its scene graph, to a diagram.

    The arm touches nothing but through the pusher, which is welded to the end of its rod, axes along the world's.

    Args:
        builder: Of the diagram.
        setup: What there is.
        time_step: s, of the plant.
        contact: The contact model.

    Returns:
        The parts.

    Raises:
        InputError: A mesh cannot be used.
    """
    found: list[ModelInstanceIndex] = []

    def hold(plant: MultibodyPlant, pusher: RigidBody) -> None:
        arm, tool = add_arm(plant, setup.twin.floor_height)
        plant.WeldFrames(tool, pusher.body_frame())
        for joint in plant.GetJointIndices(arm):
            if plant.get_joint(joint).num_velocities() == 1:
                actuator = plant.GetJointActuatorByName(plant.get_joint(joint).name(), arm)
                actuator.set_controller_gains(PdControllerGains(p=_STIFFNESS, d=_DAMPING))
        found.append(arm)

    parts = MakePushPlant(builder, dataclasses.replace(setup, plant_time_step=time_step), contact, hold)
    assert parts.plant.num_positions(found[0]) == JOINTS
    return ArmPlant(parts, found[0])
