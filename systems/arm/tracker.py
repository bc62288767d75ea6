# SPDX-License-Identifier: MIT
"""Tracking of a tool's next 0.1 s within the limits of the joints, with a rod that may swing for speed."""

import logging

import numpy as np
from pydrake.multibody.tree import JacobianWrtVariable
from pydrake.solvers import MathematicalProgram, OsqpSolver, SolverOptions
from pydrake.systems.framework import BasicVector, Context, DiscreteValues, LeafSystem

from pinwm_drake.control.velocity_limiter import VelocityLimiter, stoppable
from pinwm_drake.learning.safety import SafetyLimits
from pinwm_drake.systems.arm.model import JOINTS, ArmModel
from pinwm_drake.systems.ports import declare_vector, unowned

_STEPS, _STEP = 5, 0.02  # s, the next 0.1 s
_MARGIN = 0.02  # rad, kept from the limits of the joints' angles
_SHARE = 0.97  # of the joints' greatest speeds
# Weights beside the tool's distance [m]: of its velocity at the end, the rod's tilt, the joints' distance from nominal
# angles, and their accelerations.
_VELOCITY, _TILT, _POSTURE, _EFFORT = 0.05, 0.03, 0.003, 1e-5  # s, m/rad, m/rad, m/(rad/s^2)
_SCALE, _TOLERANCE = 1e6, 1e-5  # of the cost, m^2 to numbers that suit the solver; its relative and absolute one
_SIZE = _STEPS * JOINTS
_log = logging.getLogger("drake")  # where Drake's own integrator of inverse kinematics says that it is stuck
# Of the state.
_Q, _V, _A, _TIME = slice(0, JOINTS), slice(JOINTS, 2 * JOINTS), slice(2 * JOINTS, 2 * JOINTS + _SIZE), -1


class JointTracker(LeafSystem):  # type: ignore[misc]  # pydrake has no usable types
    """Angles and velocities of the joints that bring a tool where it is to be, within the joints' limits.

        desired_state  (6): p_WP [m],     ┌──────────────┐
                       v_WP [m/s], W ────►│              │
        wanted         (3): v_WP [m/s] ──►│ JointTracker │─► joint_state  (14): angles [rad], velocities [rad/s];
        robot_state   (14): measured, ───►│              │   no direct feedthrough; goes on between samples
                       read once          └──────────────┘

    Every T it plans the accelerations of the joints, in 5 steps of 0.02 s, by a quadratic program. The tool is to be
    near its path, which goes on towards the velocity wanted. With far less weight, the rod points down; with less
    again, the joints are at nominal angles. Angles, velocities and accelerations are bounded, and each joint can always
    stop before its limit. So the rod points down where the joints can do that at the tool's speed, and swings where
    they cannot.

    Where the program has no solution the joints brake, and a line of Drake's log says so once, until it has one again.

    It starts from measured angles when a simulator is initialized, and does not look at them later.

    Args:
        model: The arm's kinematics.
        limits: Limits of the tool's motion.
        period: T, s, of the desired state as well.
        height: m, world, that the tool keeps; None where it is that of the desired state.
        lead: s, by which the joints' servos are late.
    """

    def __init__(
        self, model: ArmModel, limits: SafetyLimits, period: float, height: float | None, lead: float = 0.0
    ) -> None:
        super().__init__()
        self._model, self._period, self._height, self._lead = model, period, height, lead
        self._limiter = VelocityLimiter(limits, _STEP)
        plant = model.plant
        self._context = plant.CreateDefaultContext()  # for kinematics: set before each use
        self._low, self._high = plant.GetPositionLowerLimits() + _MARGIN, plant.GetPositionUpperLimits() - _MARGIN
        self._fastest, self._strongest = _SHARE * plant.GetVelocityUpperLimits(), plant.GetAccelerationUpperLimits()
        self._program, self._solver, self._options = MathematicalProgram(), OsqpSolver(), SolverOptions()
        for name, value in (("polishing", 0), ("eps_abs", _TOLERANCE), ("eps_rel", _TOLERANCE)):
            self._options.SetOption(OsqpSolver.id(), name, value)
        self._unknowns = self._program.NewContinuousVariables(_SIZE)
        self._cost = self._program.AddQuadraticCost(np.eye(_SIZE), np.zeros(_SIZE), self._unknowns, is_convex=True)
        self._bounds = self._program.AddLinearConstraint(
            _BOUNDED, np.zeros(3 * _SIZE), np.zeros(3 * _SIZE), self._unknowns
        )
        self._desired = self.DeclareVectorInputPort("desired_state", 6)
        self._wanted = self.DeclareVectorInputPort("wanted", 3)
        self._measured = self.DeclareVectorInputPort("robot_state", 2 * JOINTS)
        self._stuck = False  # the last time, so that the log says it once
        self._held = self.DeclareDiscreteState(BasicVector(np.zeros(2 * JOINTS + _SIZE + 1)))
        self.DeclareInitializationDiscreteUpdateEvent(unowned(self, self._Begin))
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, unowned(self, self._Update))
        declare_vector(self, "joint_state", 2 * JOINTS, self._now, {self.xd_ticket(), self.time_ticket()})

    def _Begin(self, context: Context, values: DiscreteValues) -> None:
        q = self._measured.Eval(context)[_Q]
        values.get_mutable_vector(self._held).SetFromVector([*q, *np.zeros(JOINTS + _SIZE), context.get_time()])

    def _Update(self, context: Context, values: DiscreteValues) -> None:
        q, v = self._at(context)
        path, v_WP = self._path(self._desired.Eval(context), self._wanted.Eval(context))
        before = self._state(context)[_A].reshape(_STEPS, JOINTS)
        plan = self._planned(q, v, before, path, v_WP)
        values.get_mutable_vector(self._held).SetFromVector([*q, *v, *plan.ravel(), context.get_time()])

    def _path(self, desired: np.ndarray, wanted: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Places (5, 3) m of the tool at the ends of the coming steps, and its velocity (3,) m/s then."""
        p, v, places = desired[:3] + self._period * desired[3:], desired[3:], []
        for _ in range(_STEPS):
            faster = self._limiter.limit(wanted, v, p)
            p, v = p + 0.5 * _STEP * (v + faster), faster
            places.append(p)
        path, v = np.array(places), v.copy()
        if self._height is not None:
            path[:, 2], v[2] = self._height, 0.0
        return path, v

    def _planned(
        self, q: np.ndarray, v: np.ndarray, before: np.ndarray, path: np.ndarray, v_WP: np.ndarray
    ) -> np.ndarray:
        """Accelerations (5, 7) rad/s^2 from angles q (7,) rad with v (7,) rad/s; those `before` are near."""
        free_q = q + _STEP * np.arange(1, _STEPS + 1)[:, None] * v  # without acceleration
        ahead = (_TO_Q @ before.ravel()).reshape(_STEPS, JOINTS)
        rows = [_EFFORT * np.eye(_SIZE), _POSTURE * _TO_Q]
        aims = [np.zeros(_SIZE), _POSTURE * (self._model.nominal - free_q).ravel()]
        for step in range(_STEPS):
            p_WP, turn, J = self._kinematics(free_q[step] + ahead[step])
            moved = _TO_Q[step * JOINTS : (step + 1) * JOINTS]
            rows += [J[3:] @ moved, _TILT * J[:3] @ moved]
            aims += [path[step] - p_WP + J[3:] @ ahead[step], _TILT * (turn + J[:3] @ ahead[step])]
        rows.append(_VELOCITY * J[3:] @ _TO_V[-JOINTS:])
        aims.append(_VELOCITY * (v_WP - J[3:] @ v))
        matrix, aim = np.vstack(rows), np.concatenate(aims)
        self._cost.evaluator().UpdateCoefficients(_SCALE * matrix.T @ matrix, -_SCALE * matrix.T @ aim, 0.0, True)
        first_low, first_high = self._first(q, v)
        strongest, slack = np.tile(self._strongest, _STEPS - 1), 0.5 * _MARGIN  # so that there is a solution
        low = [first_low, -strongest, np.tile(-self._fastest - v, _STEPS), (self._low - slack - free_q).ravel()]
        high = [first_high, strongest, np.tile(self._fastest - v, _STEPS), (self._high + slack - free_q).ravel()]
        self._bounds.evaluator().UpdateCoefficients(_BOUNDED, np.concatenate(low), np.concatenate(high))
        result = self._solver.Solve(self._program, None, self._options)
        plan = result.GetSolution(self._unknowns)
        stuck = not np.isfinite(plan).all()
        if stuck:
            plan = np.tile(-v / _STEP, _STEPS)
            if not self._stuck:
                words = "JointTracker: no plan for angles %s rad (%s); the joints brake"
                _log.warning(words, q.round(3).tolist(), result.get_solution_result().name)
        self._stuck, plan = stuck, plan.reshape(_STEPS, JOINTS)
        plan[0] = np.clip(plan[0], first_low, first_high)
        return np.asarray(plan)

    def _first(self, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Bounds (7,) rad/s^2 of the coming period's accelerations, after which every joint can stop in time."""
        change = self._period * self._strongest
        low = np.maximum(-self._fastest, -stoppable(q - self._low, change, self._period))
        high = np.minimum(self._fastest, stoppable(self._high - q, change, self._period))
        return (
            np.clip((low - v) / self._period, -self._strongest, self._strongest),
            np.clip((high - v) / self._period, -self._strongest, self._strongest),
        )

    def _kinematics(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Place (3,) m of the tool at angles q (7,) rad, turn (3,) rad that brings its rod back, Jacobian (6, 7)."""
        plant, tool, world = self._model.plant, self._model.tool, self._model.plant.world_frame()
        plant.SetPositions(self._context, q)
        J = plant.CalcJacobianSpatialVelocity(self._context, JacobianWrtVariable.kV, tool, np.zeros(3), world, world)
        X_WP = tool.CalcPoseInWorld(self._context)
        R = X_WP.rotation().matrix()
        # To first order; the rod's angles are well below 90 degrees.
        turn = 0.5 * np.array([R[1, 2] - R[2, 1], R[2, 0] - R[0, 2], R[0, 1] - R[1, 0]])
        return X_WP.translation(), turn, J

    def _at(self, context: Context) -> tuple[np.ndarray, np.ndarray]:
        """Angles (7,) rad and velocities (7,) rad/s of the plan at the present time, which is in its first step."""
        held = self._state(context)
        t, first = context.get_time() - held[_TIME], held[_A][:JOINTS]
        return held[_Q] + t * held[_V] + 0.5 * t**2 * first, held[_V] + t * first

    def _now(self, context: Context) -> np.ndarray:
        q, v = self._at(context)
        return np.concatenate([q + self._lead * v, v])

    def _state(self, context: Context) -> np.ndarray:
        return np.asarray(context.get_discrete_state(self._held).value())


def _integrals() -> tuple[np.ndarray, np.ndarray]:
    """Matrices (35, 35) from accelerations to the changes of velocities and angles at the ends of the steps."""
    lower = np.tril(np.ones((_STEPS, _STEPS)))
    behind = np.arange(_STEPS)[:, None] - np.arange(_STEPS) + 0.5
    return np.kron(_STEP * lower, np.eye(JOINTS)), np.kron(_STEP**2 * lower * behind, np.eye(JOINTS))


_TO_V, _TO_Q = _integrals()
_BOUNDED = np.vstack([np.eye(_SIZE), _TO_V, _TO_Q])  # accelerations, velocities, angles
