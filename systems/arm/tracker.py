# SPDX-License-Identifier: MIT
"""Tracking of a tool's motion within the limits of the joints, with a rod that may swing where that makes it faster."""

import numpy as np
from pydrake.multibody.tree import JacobianWrtVariable
from pydrake.systems.framework import BasicVector, Context, DiscreteValues, LeafSystem
from scipy.optimize import lsq_linear

from pinwm_drake.control.velocity_limiter import stoppable
from pinwm_drake.systems.arm.model import JOINTS, ArmModel
from pinwm_drake.systems.ports import declare_vector, unowned

_MARGIN = 0.02  # rad, kept from the limits of the joints' angles
_SHARE = 0.97  # of the joints' greatest speeds
_CATCH_UP = 40.0  # 1/s: share of the tool's distance from its place that is made up for
_UPRIGHT = 8.0  # 1/s: the same of the rod's tilt
_TILT, _POSTURE = 0.03, 0.003  # m/rad: weights of the rod's and the joints' velocities, in terms of the tool's
_CENTRING = 1.0  # 1/s, towards the nominal angles
_Q, _V, _TIME = slice(0, JOINTS), slice(JOINTS, 2 * JOINTS), 2 * JOINTS
_WIDTH = 1e-9  # rad/s, of an interval at least


class JointTracker(LeafSystem):  # type: ignore[misc]  # pydrake has no usable types
    """Angles and velocities of the joints that bring a tool where it is to be, within the joints' limits.

        desired_state  (6): p_WP [m],     ┌──────────────┐
                       v_WP [m/s], W ────►│ JointTracker │─► joint_state  (14): angles [rad], velocities [rad/s];
        robot_state   (14): measured, ───►│              │   no direct feedthrough; goes on between samples
                       read once          └──────────────┘

    Every T it solves a least-squares problem for the joints' velocities of the coming period: the tool moves along, and
    makes up for its distance; with far less weight, the rod points down; with less again, the joints go to nominal
    angles. Angles, velocities and accelerations are bounded: each joint can always stop before its limit. So the rod
    points down as long as the joints can do that at the tool's speed, and swings where they cannot.

    It starts from measured angles when a simulator is initialized, and does not look at them later.

    Args:
        model: The arm's kinematics.
        period: T, s, of the desired state as well.
        height: m, world, that the tool keeps; None where it is that of the desired state.
        lead: s, by which the joints' servos are late.
    """

    def __init__(self, model: ArmModel, period: float, height: float | None, lead: float = 0.0) -> None:
        super().__init__()
        self._model, self._period, self._height, self._lead = model, period, height, lead
        plant = model.plant
        self._context = plant.CreateDefaultContext()  # for kinematics: set before each use
        self._low, self._high = plant.GetPositionLowerLimits() + _MARGIN, plant.GetPositionUpperLimits() - _MARGIN
        self._fastest = _SHARE * plant.GetVelocityUpperLimits()
        self._change = period * plant.GetAccelerationUpperLimits()
        self._desired = self.DeclareVectorInputPort("desired_state", 6)
        self._measured = self.DeclareVectorInputPort("robot_state", 2 * JOINTS)
        self._held = self.DeclareDiscreteState(BasicVector(np.zeros(2 * JOINTS + 1)))
        self.DeclareInitializationDiscreteUpdateEvent(unowned(self, self._Begin))
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, unowned(self, self._Update))
        declare_vector(self, "joint_state", 2 * JOINTS, self._now, {self.xd_ticket(), self.time_ticket()})

    def _Begin(self, context: Context, values: DiscreteValues) -> None:
        q = self._measured.Eval(context)[_Q]
        values.get_mutable_vector(self._held).SetFromVector([*q, *np.zeros(JOINTS), context.get_time()])

    def _Update(self, context: Context, values: DiscreteValues) -> None:
        held, time, desired = self._state(context), context.get_time(), self._desired.Eval(context)
        before = held[_V]
        q = held[_Q] + (time - held[_TIME]) * before
        # Where the last sample's velocity has led.
        v_WP, p_WP = desired[3:].copy(), desired[:3] + self._period * desired[3:]
        if self._height is not None:
            p_WP[2], v_WP[2] = self._height, 0.0
        values.get_mutable_vector(self._held).SetFromVector([*q, *self._velocities(q, before, p_WP, v_WP), time])

    def _velocities(self, q: np.ndarray, before: np.ndarray, p_WP: np.ndarray, v_WP: np.ndarray) -> np.ndarray:
        """Velocities (7,) rad/s of the joints at angles q (7,) rad, for a tool that is to be at p_WP with v_WP."""
        plant, tool, world = self._model.plant, self._model.tool, self._model.plant.world_frame()
        plant.SetPositions(self._context, q)
        J = plant.CalcJacobianSpatialVelocity(
            self._context, JacobianWrtVariable.kV, tool, np.zeros(3), world, world
        )
        X_WP = tool.CalcPoseInWorld(self._context)
        R = X_WP.rotation().matrix()
        # Of the rotation back, to first order; angles of the rod are well below 90 degrees.
        turn = 0.5 * np.array([R[1, 2] - R[2, 1], R[2, 0] - R[0, 2], R[0, 1] - R[1, 0]])
        low = np.maximum(before - self._change, -stoppable(q - self._low, self._change, self._period))
        high = np.minimum(before + self._change, stoppable(self._high - q, self._change, self._period))
        low, high = np.maximum(low, -self._fastest), np.minimum(high, self._fastest)
        matrix = np.vstack([J[3:], _TILT * J[:3], _POSTURE * np.eye(JOINTS)])
        aim = np.concatenate(
            [
                v_WP + _CATCH_UP * (p_WP - X_WP.translation()),
                _TILT * _UPRIGHT * turn,
                _POSTURE * _CENTRING * (self._model.nominal - q),
            ]
        )
        found = lsq_linear(matrix, aim, (low, np.maximum(high, low + _WIDTH)), method="bvls")
        return np.asarray(found.x)

    def _now(self, context: Context) -> np.ndarray:
        held = self._state(context)
        return np.concatenate([held[_Q] + (context.get_time() - held[_TIME] + self._lead) * held[_V], held[_V]])

    def _state(self, context: Context) -> np.ndarray:
        return np.asarray(context.get_discrete_state(self._held).value())
