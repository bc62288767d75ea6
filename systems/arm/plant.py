# SPDX-License-Identifier: MIT
"""Pushing scene with an arm: a MultibodyPlant in which the pusher is the arm's tool."""

import dataclasses

from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import ModelInstanceIndex, PdControllerGains, RigidBody
from pydrake.systems.framework import DiagramBuilder

from pinwm_drake.systems.arm.model import JOINTS, ArmName, add_arm
from pinwm_drake.systems.engines.plant.scene import MakeScenePlant, ScenePlant
from pinwm_drake.systems.scenario.setup import Setup
from pinwm_drake.systems.sdf.twin import ContactName

# N m/rad and N m s/rad of each joint's servo, which Drake's discrete solvers treat implicitly: a tool that is pushed
# with 1 N gives way by a hundredth of a millimetre.
_STIFFNESS, _DAMPING = 4e4, 8e2


def MakeArmPlant(
    builder: DiagramBuilder,
    setup: Setup,
    time_step: float,
    contact: ContactName = "hydroelastic",
    arm: ArmName = "iiwa",
) -> tuple[ScenePlant, ModelInstanceIndex]:
    """Add a finalized plant, and its scene graph, to a diagram.

    The arm touches nothing but through the pusher, which is welded to the end of its rod, axes along the world's.

    Args:
        builder: Builder of the diagram.
        setup: The scene and its settings.
        time_step: s, of the plant.
        contact: The contact model.
        arm: Name of the arm, of `ARMS`.

    Returns:
        Object, pusher, which has no joints of its own, plant and scene graph; and the model instance of the arm:
        positions (7) [rad], velocities (7) [rad/s]. The plant's input port for its desired state has both.

    Raises:
        InputError: A mesh cannot be used.
    """
    found: list[ModelInstanceIndex] = []

    def hold(plant: MultibodyPlant, pusher: RigidBody) -> None:
        instance, tool = add_arm(plant, setup.twin.floor_height, arm)
        plant.WeldFrames(tool, pusher.body_frame())
        for joint in plant.GetJointIndices(instance):
            if plant.get_joint(joint).num_velocities() == 1:
                actuator = plant.GetJointActuatorByName(plant.get_joint(joint).name(), instance)
                actuator.set_controller_gains(PdControllerGains(p=_STIFFNESS, d=_DAMPING))
        found.append(instance)

    parts = MakeScenePlant(builder, dataclasses.replace(setup, plant_time_step=time_step), contact, hold)
    assert parts.plant.num_positions(found[0]) == JOINTS
    return parts, found[0]
