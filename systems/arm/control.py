# SPDX-License-Identifier: MIT
"""Control of the simulated driver's arm: velocities of its tool in, angles and velocities of its joints out."""

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform
from pydrake.multibody.inverse_kinematics import (
    DifferentialInverseKinematicsIntegrator,
    DifferentialInverseKinematicsParameters,
)
from pydrake.multibody.math import SpatialVelocity
from pydrake.multibody.tree import BodyIndex
from pydrake.systems.framework import Context, DiagramBuilder, InputPort, LeafSystem, OutputPort
from pydrake.systems.primitives import StateInterpolatorWithDiscreteDerivative

from pinwm_drake.learning.safety import SafetyLimits
from pinwm_drake.systems.arm.interpolator import CommandInterpolator
from pinwm_drake.systems.arm.model import JOINTS, ArmModel
from pinwm_drake.systems.arm.tracker import JointTracker
from pinwm_drake.systems.ports import declare_value, declare_vector

_MARGIN = 0.02  # rad, kept from the limits of the joints
_SHARE = 0.95  # of the joints' greatest speeds
_CENTRING = 1.0  # 1/s, towards the nominal angles, in the one direction that the tool does not feel


def AddArmControl(
    builder: DiagramBuilder, model: ArmModel, limits: SafetyLimits, period: float, height: float | None, lead: float
) -> tuple[CommandInterpolator, InputPort, OutputPort]:
    """Add the control of an arm, from commands to its joints' servos, to a diagram.

        velocity ─► CommandInterpolator ─► ToolPose ─► DifferentialInverseKinematicsIntegrator ─►
            ─► StateInterpolatorWithDiscreteDerivative ─► joints

    or, of an arm whose rod may swing,

        velocity ─► CommandInterpolator ─► JointTracker ─► joints

    All of it runs every `period`. It starts from the measured pose when a simulator is initialized.

    Args:
        builder: Builder of the diagram.
        model: The arm's kinematics.
        limits: Limits of the tool's motion.
        period: s.
        height: m, world, that the tool keeps; None where commands move it up and down too.
        lead: s, by which the joints' servos are late, for a JointTracker.

    Returns:
        The first system, whose inputs are to be connected; an input port that is to have measured angles [rad] and
        velocities [rad/s] of the joints, (14); and an output port (14) with those that are wanted.
    """
    stream = builder.AddNamedSystem("command_interpolator", CommandInterpolator(limits, period))
    if model.kind.swings:
        tracker = builder.AddNamedSystem("joint_tracker", JointTracker(model, limits, period, height, lead))
        for name in ("desired_state", "wanted"):
            builder.Connect(stream.GetOutputPort(name), tracker.GetInputPort(name))
        return stream, tracker.GetInputPort("robot_state"), tracker.get_output_port()
    pose = builder.AddNamedSystem("tool_pose", ToolPose(height))
    integrator = DifferentialInverseKinematicsIntegrator(
        model.plant, model.tool, period, _parameters(model), log_only_when_result_state_changes=True
    )
    kinematics = builder.AddNamedSystem("differential_kinematics", integrator)
    kinematics.model = model  # which it refers to and does not keep
    joints = builder.AddNamedSystem("joint_targets", StateInterpolatorWithDiscreteDerivative(JOINTS, period))
    builder.Connect(stream.GetOutputPort("desired_state"), pose.get_input_port())
    builder.Connect(pose.get_output_port(), kinematics.GetInputPort("X_AE_desired"))
    builder.Connect(kinematics.GetOutputPort("joint_positions"), joints.get_input_port())
    return stream, kinematics.GetInputPort("robot_state"), joints.get_output_port()


def _parameters(model: ArmModel) -> DifferentialInverseKinematicsParameters:
    plant = model.plant
    parameters = DifferentialInverseKinematicsParameters(JOINTS, JOINTS)
    low, high = plant.GetPositionLowerLimits() + _MARGIN, plant.GetPositionUpperLimits() - _MARGIN
    parameters.set_joint_position_limits((low, high))
    fastest = _SHARE * plant.GetVelocityUpperLimits()
    parameters.set_joint_velocity_limits((-fastest, fastest))
    parameters.set_nominal_joint_position(model.nominal)
    parameters.set_joint_centering_gain(_CENTRING * np.eye(JOINTS))
    return parameters


class ToolPose(LeafSystem):  # type: ignore[misc]  # pydrake has no usable types
    """Desired pose of a tool that keeps pointing down, at one height or at any.

                                            ┌──────────┐
        desired_state  (6): p_WP [m],  ────►│ ToolPose │─► X_WP  RigidTransform: axes of the world, at p_WP
                            v_WP [m/s], W   └──────────┘   direct feedthrough

    With a `height` [m, world] of its own, commands along z have no effect; None is that of the desired state.
    """

    def __init__(self, height: float | None) -> None:
        super().__init__()
        state = self.DeclareVectorInputPort("desired_state", 6)

        def pose(context: Context) -> RigidTransform:
            x, y, z = state.Eval(context)[:3]
            return RigidTransform([x, y, z if height is None else height])

        declare_value(self, "X_WP", RigidTransform(), pose)


class ToolState(LeafSystem):  # type: ignore[misc]  # pydrake has no usable types
    """Position and velocity of a tool's body, picked from all bodies of a plant.

                                                        ┌───────────┐
        body_poses       Value[list[RigidTransform]] ──►│ ToolState │─► pusher_state  (6): p_WP [m], v_WP [m/s], W
        body_velocities  Value[list[SpatialVelocity]] ─►│           │
                                                        └───────────┘   direct feedthrough

    Both inputs are the outputs of a MultibodyPlant, in the order of its bodies; frame P is that of `body`.
    """

    def __init__(self, body: BodyIndex) -> None:
        super().__init__()
        poses = self.DeclareAbstractInputPort("body_poses", AbstractValue.Make([RigidTransform()]))
        velocities = self.DeclareAbstractInputPort("body_velocities", AbstractValue.Make([SpatialVelocity()]))

        def state(context: Context) -> np.ndarray:
            X_WP, V_WP = (port.Eval(context)[int(body)] for port in (poses, velocities))
            return np.concatenate([X_WP.translation(), V_WP.translational()])

        declare_vector(self, "pusher_state", 6, state)
